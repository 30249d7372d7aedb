// Filters, reading of plots, the wipe between two images, links and printing.
"use strict";
const form = document.getElementById("filters");
const selects = [...form.querySelectorAll("select")];
const boxes = [...form.querySelectorAll("[name=method]")];

// The address after "#" is the state: stem=city&camera=roof&without=cycles&at=scene-2, or a plain id.
function readState() {
  const hash = location.hash.slice(1);
  return new URLSearchParams(hash.includes("=") || !hash ? hash : { at: hash });
}

function applyState() {
  const state = readState();
  const without = new Set(state.getAll("without"));
  for (const select of selects) {
    select.value = state.get(select.name) ?? "";
    if (select.selectedIndex < 0) select.value = "";
  }
  for (const box of boxes) box.checked = !without.has(box.value);
  for (const part of document.querySelectorAll("[data-stem], [data-method]")) {
    const isOther = selects.some((select) => select.value && (part.dataset[select.name] ?? select.value) !== select.value);
    part.classList.toggle("off", isOther || without.has(part.dataset.method));
  }
  tellState(without);
  // Other pages of this report get the filters along, but not the place on this one.
  state.delete("at");
  for (const link of document.querySelectorAll('a[href*="report.html"]')) {
    link.dataset.part ??= link.hash.slice(1);
    const target = new URLSearchParams(state);
    if (link.dataset.part) target.set("at", link.dataset.part);
    link.hash = state.size ? target : link.dataset.part;
  }
  document.querySelectorAll(".plot svg").forEach(keepOneTabStop);
  document.querySelectorAll(".wipe").forEach(fillWipe);
  dispatchEvent(new Event("filtered"));
}

function tellState(without) {
  const scenes = [...document.querySelectorAll(".index tbody tr")];
  const shown = scenes.filter((row) => !row.classList.contains("off"));
  const hidden = boxes.map((box) => box.value).filter((name) => without.has(name));
  const parts = [];
  if (shown.length < scenes.length) parts.push(`${shown.length} of ${scenes.length} scenes`);
  if (hidden.length) parts.push(`without ${hidden.join(", ")}`);
  const all = parts.length && document.querySelector(".headline") ? " The headline counts all scenes." : "";
  form.querySelector("output").textContent = parts.length ? `Shown: ${parts.join(", ")}.${all}` : "";
  form.classList.toggle("active", parts.length > 0);
}

function saveState() {
  const state = new URLSearchParams();
  for (const select of selects) if (select.value) state.set(select.name, select.value);
  for (const box of boxes) if (!box.checked) state.append("without", box.value);
  // A page from a file may change its address only after "#".
  history.replaceState(null, "", `#${state}`);
  applyState();
}

function goToPlace() {
  const place = document.getElementById(readState().get("at") ?? "");
  if (place) place.scrollIntoView();
}

form.addEventListener("change", saveState);
form.addEventListener("submit", (event) => event.preventDefault());
form.addEventListener("reset", () => setTimeout(saveState));
addEventListener("hashchange", () => { applyState(); goToPlace(); });
document.addEventListener("click", (event) => {
  const link = event.target.closest('a[href^="#"]');
  const state = readState();
  state.delete("at");
  if (!link || !state.size) return;
  event.preventDefault();
  state.set("at", link.hash.slice(1));
  location.hash = state;
});

// A plot is one tab stop; arrow keys go along a curve and from curve to curve.
function shownPoints(svg) {
  const curves = [...svg.querySelectorAll(".curve:not(.off)")];
  return curves.map((curve) => [...curve.querySelectorAll(".point")]).filter((points) => points.length);
}

function keepOneTabStop(svg) {
  const points = shownPoints(svg).flat();
  if (!points.some((point) => point.tabIndex === 0) && points.length) points[0].tabIndex = 0;
}

const STEPS = { ArrowRight: [0, 1], ArrowLeft: [0, -1], ArrowDown: [1, 0], ArrowUp: [-1, 0] };
for (const svg of document.querySelectorAll(".plot svg")) {
  const output = svg.parentElement.querySelector("output");
  const tell = (event) => {
    const point = event.target.closest(".point");
    if (point) output.textContent = point.querySelector("title").textContent;
  };
  svg.addEventListener("pointerover", tell);
  svg.addEventListener("focusin", tell);
  svg.addEventListener("keydown", (event) => {
    const here = event.target.closest(".point");
    const step = STEPS[event.key];
    if (!here || !step) return;
    event.preventDefault();
    const curves = shownPoints(svg);
    const row = curves.findIndex((points) => points.includes(here));
    const points = curves[(row + step[0] + curves.length) % curves.length];
    const column = curves[row].indexOf(here) + step[1];
    const next = points[Math.min(Math.max(column, 0), points.length - 1)];
    here.tabIndex = -1;
    next.tabIndex = 0;
    next.focus();
  });
}

// The wipe takes its images from the pictures of its scene.
function fillWipe(wipe) {
  const figures = [...wipe.parentElement.querySelectorAll("[data-picture]:not(.off)")];
  const names = figures.map((figure) => figure.dataset.picture);
  wipe.hidden = names.length < 2;
  if (wipe.hidden) return;
  const sides = [...wipe.querySelectorAll("select")];
  const [first, second] = names.filter((name) => name !== "reference");
  const defaults = [names.includes("lighttree") ? "lighttree" : first, names.includes("cycles") ? "cycles" : second];
  sides.forEach((select, side) => {
    const kept = names.includes(select.value) ? select.value : defaults[side] ?? "reference";
    select.replaceChildren(...names.map((name) => new Option(name)));
    select.value = kept;
  });
  drawWipe(wipe);
}

function drawWipe(wipe) {
  const [left, right] = [...wipe.querySelectorAll("select")].map((select) => select.value);
  const pair = wipe.querySelector(".pair");
  if (pair.dataset.names !== `${right}|${left}`) {
    pair.dataset.names = `${right}|${left}`;
    const picture = (name) => wipe.parentElement.querySelector(`[data-picture="${CSS.escape(name)}"] img`);
    pair.replaceChildren(picture(right).cloneNode(), picture(left).cloneNode());
  }
  pair.style.setProperty("--cut", `${wipe.querySelector("[type=range]").value}%`);
}

for (const wipe of document.querySelectorAll(".wipe")) {
  wipe.addEventListener("input", () => drawWipe(wipe));
}

// Paper shows what a click would.
addEventListener("beforeprint", () => {
  for (const details of document.querySelectorAll(".values:not([open]), #worse ~ details:not([open])")) {
    details.dataset.closed = "";
    details.open = true;
  }
});
addEventListener("afterprint", () => {
  for (const details of document.querySelectorAll("[data-closed]")) {
    delete details.dataset.closed;
    details.open = false;
  }
});

form.hidden = false;
applyState();
if (readState().size > 1) goToPlace();
