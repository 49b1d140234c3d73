"use strict";
// Plots that every page shares: colours that follow light and dark, interval bands, zoom, and drawing when they come
// into view. A page asks for them with `plotWhenSeen`.

const data = JSON.parse(document.getElementById("data").textContent);
const root = document.documentElement;
const BEYOND = 100; // an interval that is open upwards ends so many times above the plot's upper end
const plots = [];   // {figure, spec, plot, zoom}

function isDark() {
  const chosen = root.dataset.theme;
  return chosen ? chosen === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
}

function style(name) { return getComputedStyle(root).getPropertyValue(name).trim(); }

// A colour of the page ("--ink") or one that differs between light and dark.
function colourOf(colour) {
  if (typeof colour === "string") return colour.startsWith("--") ? style(colour) : colour;
  return isDark() ? colour.dark : colour.light;
}

const repaints = []; // what is called when light becomes dark, or dark light
function repaintAll() { for (const repaint of repaints) repaint(); }
document.getElementById("theme").addEventListener("click", () => {
  root.dataset.theme = isDark() ? "light" : "dark";
  repaintAll();
});
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", repaintAll);

function percentile(values, part) {
  const sorted = values.filter((value) => value !== null).sort((a, b) => a - b);
  return sorted.length ? sorted[Math.min(sorted.length - 1, Math.floor(part * sorted.length))] : 0;
}

function bounded(value, low, high) { return Math.min(high, Math.max(low, value)); }

// spec: title, unit, x, xLabel, xRange (what is shown before one zooms), lines [{label, values, colour, low, high, dash, dots}], range [low, high] or null,
// sync (plots of one name share pointer and zoom), clock (whose
// present is shown, see setPresent), onPick(x)
function uplotOptions(entry) {
  const { spec, figure } = entry;
  const series = [{ label: spec.xLabel, value: (u, v) => (v === null ? "–" : v.toFixed(2)) }];
  const bands = [];
  const columns = [spec.x];
  for (const line of spec.lines) {
    const colour = colourOf(line.colour);
    const at = columns.length;
    columns.push(line.values);
    series.push({
      label: line.label, stroke: colour, width: line.dots ? 0 : 2, dash: line.dash, points: { size: 4, fill: colour, ...(line.dots ? { show: true } : {}) },
      value: (u, v, s, i) => (v === null || v === undefined ? "–" : described(line, v, i, spec.unit)),
    });
    if (line.low) {
      columns.push(line.high, line.low);
      for (const _ of [0, 1]) series.push({ class: "quiet", stroke: colour + "55", width: 1, points: { show: false } });
      bands.push({ series: [at + 1, at + 2], fill: colour + "33" });
    }
  }
  const axis = { stroke: style("--muted"), grid: { stroke: style("--line"), width: 1 }, ticks: { stroke: style("--line"), width: 1 } };
  const options = {
    title: spec.title,
    width: figure.clientWidth, height: spec.height || 220,
    series, bands,
    axes: [{ ...axis, label: spec.xLabel, labelSize: 18, size: 34 }, { ...axis, size: 52 }],
    scales: { x: { time: false, range: (u, low, high) => shownRange(spec, low, high) }, y: spec.range ? { range: spec.range } : {} },
    cursor: {
      drag: { x: true, y: false, dist: 6 }, focus: { prox: 24 },
      ...(spec.sync ? { sync: { key: spec.sync, setSeries: false, scales: ["x", null] } } : {}),
    },
    hooks: { setScale: [(u, key) => key === "x" && spreadZoom(entry, u)], ready: [(u) => becomeReady(entry, u)] },
  };
  return { options, columns };
}

function shownRange(spec, low, high) {
  const isAll = low === null || (low <= spec.x[0] && high >= spec.x.at(-1));
  if (isAll && spec.xRange && spec.xRange[0] < spec.xRange[1]) return spec.xRange;
  return [low, high];
}

function described(line, value, i, unit) {
  const text = Math.abs(value) >= 100 ? value.toFixed(0) : value.toPrecision(3);
  if (!line.low || line.low[i] === null) return `${text} ${unit}`;
  const high = line.isOpen && line.isOpen[i] ? "∞" : line.high[i].toPrecision(3);
  return `${text} ${unit} (${line.low[i].toPrecision(3)} – ${high})`;
}

function becomeReady(entry, u) {
  if (entry.spec.clock) {
    entry.mark = document.createElement("div");
    entry.mark.className = "present";
    u.over.append(entry.mark);
  }
  let downAt = null;
  u.over.addEventListener("mousedown", (event) => { downAt = event.clientX; });
  u.over.addEventListener("click", (event) => {
    const isDrag = downAt !== null && Math.abs(event.clientX - downAt) > 5;
    if (!isDrag && entry.spec.onPick) entry.spec.onPick(u.posToVal(event.clientX - u.over.getBoundingClientRect().left, "x"));
  });
}

// Plots of one run show the same time.
let isSpreading = false;
function spreadZoom(entry, u) {
  placeMark(entry, u);
  if (isSpreading || !entry.spec.sync || entry.plot !== u) return;
  isSpreading = true;
  const { min, max } = u.scales.x;
  for (const other of plots) {
    if (other === entry || other.spec.sync !== entry.spec.sync) continue;
    other.zoomX = { min, max };
    if (other.plot) other.plot.setScale("x", { min, max });
  }
  isSpreading = false;
}

function placeMark(entry, u) {
  if (!entry.mark || entry.present === undefined) return;
  const { min, max } = u.scales.x;
  entry.mark.hidden = entry.present < min || entry.present > max;
  entry.mark.style.left = `${u.valToPos(entry.present, "x")}px`;
}

function setPresent(clock, x) {
  for (const entry of plots) {
    if (entry.spec.clock !== clock) continue;
    entry.present = x;
    if (entry.plot) placeMark(entry, entry.plot);
  }
}

function draw(entry) {
  const zoom = entry.plot ? { min: entry.plot.scales.x.min, max: entry.plot.scales.x.max } : entry.zoomX;
  if (entry.plot) entry.plot.destroy();
  const { options, columns } = uplotOptions(entry);
  entry.plot = null;
  const plot = new uPlot(options, columns, entry.figure);
  entry.plot = plot;
  if (zoom) plot.setScale("x", zoom);
  placeMark(entry, plot);
}

const watcher = new IntersectionObserver((changes) => {
  for (const change of changes) {
    const entry = plots.find((one) => one.figure === change.target);
    if (change.isIntersecting && entry && !entry.plot) draw(entry);
  }
}, { rootMargin: "300px" });

function plotWhenSeen(figure, spec) {
  const entry = { figure, spec, plot: null };
  figure.setAttribute("role", "img");
  figure.style.minHeight = `${(spec.height || 220) + 60}px`;
  plots.push(entry);
  watcher.observe(figure);
}

repaints.push(() => { for (const entry of plots) if (entry.plot) draw(entry); });

let resizing = null;
addEventListener("resize", () => {
  clearTimeout(resizing);
  resizing = setTimeout(() => {
    for (const { plot, figure, spec } of plots) if (plot) plot.setSize({ width: figure.clientWidth, height: spec.height || 220 });
  }, 100);
});

// Paper is white, and shows everything.
let before = null;
addEventListener("beforeprint", () => {
  before = { theme: root.dataset.theme, closed: [...document.querySelectorAll("main details:not([open])")] };
  root.dataset.theme = "light";
  for (const details of before.closed) details.open = true;
  repaintAll();
  for (const entry of plots) if (!entry.plot) draw(entry);
});
addEventListener("afterprint", () => {
  if (before.theme) root.dataset.theme = before.theme; else delete root.dataset.theme;
  for (const details of before.closed) details.open = false;
  repaintAll();
});
