// Put a flip book into each scene once it comes near, as large as its image fits.
"use strict";
// Without WebGL the flip book would open one alert per image.
const hasWebGl = Boolean(new OffscreenCanvas(1, 1).getContext("webgl2"));

function makeBook(viewer) {
  const book = JSON.parse(document.querySelector(`[data-viewer="${viewer.id}"]`).textContent);
  const isShown = (name) => !viewer.parentElement.querySelector(`.off[data-picture="${CSS.escape(name)}"]`);
  const kept = [...book.names.keys()].filter((index) => isShown(book.names[index]));
  const names = kept.map((index) => book.names[index]);
  if (viewer.dataset.names === String(names)) return;
  viewer.dataset.names = names;
  for (const key of ["names", "dataUrls", "types"]) book[key] = kept.map((index) => book[key][index]);
  const aspect = book.width / book.height;
  viewer.style = "";
  const hideTools = viewer.clientWidth < 600;
  const toolsHeight = hideTools ? 56 : 120;
  const height = Math.min(viewer.clientWidth / aspect, Math.max(0.85 * innerHeight - toolsHeight, 160));
  viewer.style.height = `${height + toolsHeight}px`;
  viewer.style.maxWidth = `${height * aspect}px`;
  const inner = document.createElement("div");
  inner.id = `${viewer.id}-book`;
  inner.style.height = "100%";
  viewer.replaceChildren(inner);
  if (names.length) flipbook.MakeFlipBook({ ...book, hideTools, containerId: inner.id });
}

const nearby = new IntersectionObserver((entries) => {
  for (const { target, isIntersecting } of entries) {
    target.dataset.near = isIntersecting;
    if (isIntersecting) makeBook(target);
  }
}, { rootMargin: "50%" });

for (const viewer of document.querySelectorAll(".viewer")) {
  if (!hasWebGl) {
    viewer.textContent = "The HDR viewer needs WebGL 2, which this browser does not offer.";
    continue;
  }
  nearby.observe(viewer);
  // The flip book numbers its tab stops, which would put them before everything else.
  new MutationObserver(() => {
    for (const part of viewer.querySelectorAll("[tabindex]:not([tabindex='0'])")) part.tabIndex = 0;
  }).observe(viewer, { childList: true, subtree: true });
}
addEventListener("filtered", () => {
  for (const viewer of document.querySelectorAll(".viewer[data-near=true]")) makeBook(viewer);
});
