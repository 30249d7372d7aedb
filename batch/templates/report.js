// Put a flip book into each scene, as large as its image fits.
"use strict";
// Without WebGL the flip book would open one alert per image.
const hasWebGl = Boolean(new OffscreenCanvas(1, 1).getContext("webgl2"));
for (const viewer of document.querySelectorAll(".viewer")) {
  if (!hasWebGl) {
    viewer.textContent = "The HDR viewer needs WebGL 2, which this browser does not offer.";
    continue;
  }
  const book = JSON.parse(document.querySelector(`[data-viewer="${viewer.id}"]`).textContent);
  const aspect = book.width / book.height;
  const hideTools = viewer.clientWidth < 600;
  const toolsHeight = hideTools ? 56 : 120;
  const height = Math.min(viewer.clientWidth / aspect, Math.max(0.85 * innerHeight - toolsHeight, 160));
  viewer.style.height = `${height + toolsHeight}px`;
  viewer.style.maxWidth = `${height * aspect}px`;
  flipbook.MakeFlipBook({ ...book, hideTools, containerId: viewer.id });
  // The flip book numbers its tab stops, which would put them before everything else.
  new MutationObserver(() => {
    for (const part of viewer.querySelectorAll("[tabindex]:not([tabindex='0'])")) part.tabIndex = 0;
  }).observe(viewer, { childList: true, subtree: true });
}
