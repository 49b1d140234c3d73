"use strict";
// Reports of runs: video, timeline, plots and the sphere of directions show one moment, and each can choose it.

const TICKS_PER_S = 10000;
const LONGEST_S = 20;       // times above this are cut off in plots until one zooms
const FOUND_PX = 14;        // a click on the sphere takes a dot as near as this

function summed(steps) { let total = 0; return steps.map((step) => (total += step)); }

// Largest i with values[i] <= value; values ascend.
function placeOf(values, value) {
  let low = 0, high = values.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (values[middle] <= value) low = middle; else high = middle - 1;
  }
  return low;
}

function nearestPlace(values, value) {
  const i = placeOf(values, value);
  return i + 1 < values.length && values[i + 1] - value < value - values[i] ? i + 1 : i;
}

class RunView {
  constructor(section, run) {
    this.section = section;
    this.run = run;
    this.frame = summed(run.clock.frame);
    this.t = summed(run.clock.ticks).map((ticks) => ticks / TICKS_PER_S);
    // In the video every picture stands after the one before, whatever the input's clock says.
    this.videoTime = [];
    for (const t of this.t) this.videoTime.push(Math.max(t - this.t[0], this.videoTime.at(-1) ?? 0));
    this.sync = `run${section.dataset.run}`;
    this.video = section.querySelector("video");
    this.cursor = section.querySelector(".timeline .cursor");
    this.listeners = [];
    this.at = 0;
    this.rowAt = run.objects.map((object) => new Map(object.at.map((at, row) => [at, row])));
    this.colourEverything();
    this.listenToVideo();
    this.listenToTimeline();
    this.section.addEventListener("click", (event) => {
      const button = event.target.closest("[data-frame]");
      if (button) this.go(placeOf(this.frame, Number(button.dataset.frame)));
    });
    this.plotAll();
  }

  colourEverything() {
    const colours = new Map(this.run.objects.map((object) => [String(object.id), object.colour]));
    for (const element of this.section.querySelectorAll("[data-colour]")) {
      const colour = colours.get(element.dataset.colour);
      if (colour) element.style.background = colourOf(colour);
    }
  }

  // Show a place in the clip everywhere, and take the video there.
  go(at, isOfUser = true) {
    at = bounded(at, 0, this.t.length - 1);
    if (this.video && this.video.readyState > 0) {
      // Into the frame, not on its border, where rounding would show the one before.
      const next = this.videoTime[at + 1] ?? this.videoTime[at] + this.run.dt_s;
      this.video.currentTime = this.videoTime[at] + 0.4 * (next - this.videoTime[at]);
    } else if (this.video) {
      this.wanted = at;
    }
    this.show(at);
    if (isOfUser) {
      RunView.chosen = this;
      goTogether(this);
    }
  }

  show(at) {
    this.at = at;
    const t = this.t[at];
    setPresent(this.sync, t);
    if (this.cursor) {
      const track = this.section.querySelector(".timeline .track");
      this.cursor.style.left = `${track.offsetLeft + (track.clientWidth * (t - this.t[0])) / Math.max(this.t.at(-1) - this.t[0], 1e-9)}px`;
    }
    this.section.querySelector(".now .place").textContent = `Frame ${this.frame[at]}, ${t.toFixed(2)} s`;
    this.section.querySelector(".now .what").textContent = this.describe(at);
    for (const listener of this.listeners) listener(at);
  }

  describe(at) {
    const words = [];
    this.run.objects.forEach((object, i) => {
      const row = this.rowAt[i].get(at);
      if (row === undefined) return;
      const ttc = object.ttc_z[row];
      words.push([ttc !== null && ttc > 0 ? ttc : Infinity, ttc !== null && ttc > 0
        ? `object ${object.id}: ${ttc.toFixed(2)} s (${interval(object, "ttc_z", row)})` : `object ${object.id}`]);
    });
    words.sort((a, b) => a[0] - b[0]);
    const shown = words.slice(0, 4).map((word) => word[1]);
    if (words.length > 4) shown.push(`${words.length - 4} more`);
    return shown.length ? shown.join("; ") : "no object";
  }

  listenToVideo() {
    const video = this.video;
    if (!video) return;
    video.addEventListener("error", () => { this.section.querySelector(".missing").hidden = false; });
    if (video.error) this.section.querySelector(".missing").hidden = false;
    video.addEventListener("loadedmetadata", () => this.go(this.wanted ?? this.at, false));
    // What is still told of the frame before, while the video is on its way to another, is out of date.
    const shownTime = (seconds) => { if (!video.seeking) this.show(placeOf(this.videoTime, seconds + 1e-3)); };
    video.addEventListener("seeked", () => shownTime(video.currentTime));
    if (video.requestVideoFrameCallback) {
      const tell = (now, about) => { shownTime(about.mediaTime); video.requestVideoFrameCallback(tell); };
      video.requestVideoFrameCallback(tell);
    } else {
      video.addEventListener("timeupdate", () => shownTime(video.currentTime));
    }
    video.addEventListener("play", () => { RunView.chosen = this; });
    if (video.readyState > 0) this.go(this.at, false);
  }

  listenToTimeline() {
    const ticks = this.section.querySelector(".timeline .ticks");
    if (!ticks) return;
    const start = this.t[0], length = this.t.at(-1) - start;
    for (let i = 0; i <= 4; i++) {
      const tick = document.createElement("span");
      tick.textContent = (start + (length * i) / 4).toFixed(1);
      tick.style.left = `${25 * i}%`;
      ticks.append(tick);
    }
    for (const track of this.section.querySelectorAll(".timeline [data-seeks]")) {
      track.addEventListener("click", (event) => {
        if (event.target.closest("[data-frame]")) return;
        const box = track.getBoundingClientRect();
        this.go(nearestPlace(this.t, start + (length * (event.clientX - box.left)) / box.width));
      });
    }
  }

  lifeOf(object) {
    const [start, end] = [this.t[object.at[0]], this.t[object.at.at(-1)]];
    const margin = 0.05 * (end - start) + this.run.dt_s;
    return [start - margin, end + margin];
  }

  pick(t) { this.go(nearestPlace(this.t, t)); }

  plotAll() {
    const shared = { xRange: [this.t[0], this.t.at(-1)], xLabel: "time, s", sync: this.sync, clock: this.sync, onPick: (t) => this.pick(t) };
    for (const figure of this.section.querySelectorAll("figure[data-plot]")) {
      const make = PLOTS[figure.dataset.plot];
      const object = this.run.objects.find((one) => String(one.id) === figure.dataset.object);
      const own = object ? { sync: `${this.sync}-${object.id}`, xRange: this.lifeOf(object) } : {};
      plotWhenSeen(figure, { ...shared, ...own, ...make(this, object) });
    }
    drawSphere(this, this.section.querySelector(".sphere"));
  }
}

function interval(object, name, row) {
  const low = object[`${name}_lo`][row], high = object[`${name}_hi`][row];
  if (low === null || high === null) return "no interval";
  return low > high ? `more than ${low.toFixed(2)}` : `${low.toFixed(2)} to ${high.toFixed(2)}`;
}

// A column of an object over the clip's time, with a gap where the object is not there.
function withGaps(view, object, columns) {
  const longest = object.every > 1 ? 2 * object.every : 1;
  const x = [], out = columns.map(() => []);
  object.at.forEach((at, row) => {
    if (row > 0 && at - object.at[row - 1] > longest) {
      x.push((view.t[at] + view.t[object.at[row - 1]]) / 2);
      out.forEach((column) => column.push(null));
    }
    x.push(view.t[at]);
    columns.forEach((column, i) => out[i].push(column[row]));
  });
  return { x, columns: out };
}

// A time with its interval, where the object comes nearer; an interval that is open upwards has its flag.
function approachingLine(object, name, columns) {
  const [values, low, high] = columns.map((column) => column.slice());
  const isOpen = values.map((value, i) => low[i] !== null && low[i] > high[i]);
  for (let i = 0; i < values.length; i++) {
    if (isOpen[i]) high[i] = BEYOND * LONGEST_S;
    else if (values[i] === null || values[i] <= 0) values[i] = low[i] = high[i] = null;
    else if (low[i] !== null && low[i] < 0) low[i] = 0;
  }
  return { values, low, high, isOpen };
}

function upperEnd(values, least, most) { return bounded(1.3 * percentile(values, 0.8), least, most); }

const PLOTS = {
  times(view, object) {
    const { x, columns } = withGaps(view, object, ["ttc_z", "ttc_z_lo", "ttc_z_hi", "tcpa", "tcpa_lo", "tcpa_hi"].map((name) => object[name]));
    const depth = approachingLine(object, "ttc_z", columns.slice(0, 3));
    const closest = approachingLine(object, "tcpa", columns.slice(3));
    return {
      title: "time to collision and to closest approach, s", unit: "s", x,
      range: [0, upperEnd([...depth.values, ...closest.values], 2, LONGEST_S)],
      lines: [
        { label: "until depth zero (ttc_z)", colour: object.colour, ...depth },
        { label: "until closest approach (tcpa)", colour: "--muted", dash: [5, 4], ...closest },
      ],
    };
  },
  miss(view, object) {
    const { x, columns: [values, low, high] } = withGaps(view, object, [object.miss, object.miss_lo, object.miss_hi]);
    return {
      title: "miss distance, s of relative motion", unit: "s", x, height: 160,
      range: [0, upperEnd(values, 0.2, LONGEST_S)], lines: [{ label: "miss", colour: object.colour, values, low, high }],
    };
  },
  all(view) {
    const places = [...new Set(view.run.objects.flatMap((object) => object.at))].sort((a, b) => a - b);
    const rowOf = new Map(places.map((at, i) => [at, i]));
    const lines = view.run.objects.map((object) => {
      const values = new Array(places.length).fill(null);
      object.at.forEach((at, row) => { if (object.ttc_z[row] > 0) values[rowOf.get(at)] = object.ttc_z[row]; });
      return { label: String(object.id), colour: object.colour, values };
    }).filter((line) => line.values.some((value) => value !== null));
    return { title: "time to collision of all objects, s", unit: "s", x: places.map((at) => view.t[at]), height: 260, range: [0, 10], lines };
  },
  rotation(view) {
    const frames = view.run.frames;
    const names = { x: "pitch (about x)", y: "yaw (about y)", z: "roll (about z)" };
    const colours = { x: "#009e73", y: "#0072b2", z: "#cc79a7" };
    const lines = ["x", "y", "z"].map((axis) => banded(names[axis], colours[axis], frames.rates[axis], frames.rate_half));
    return { title: "own rotation, °/s", unit: "°/s", x: frames.at.map((at) => view.t[at]), lines };
  },
  heading(view) {
    const frames = view.run.frames;
    const lines = [["to the right", "#0072b2"], ["up", "#009e73"]].map(([label, colour], i) =>
      banded(label, colour, frames.heading[i], frames.heading_half[i]));
    return { title: "own direction of motion, from the optical axis, °", unit: "°", x: frames.at.map((at) => view.t[at]), lines };
  },
  tracks(view) {
    const frames = view.run.frames;
    return { title: "tracks", unit: "", x: frames.at.map((at) => view.t[at]), lines: [{ label: "tracks", colour: "--accent", values: frames.n_tracks }] };
  },
};

function banded(label, colour, values, half) {
  const moved = (sign) => values.map((value, i) => (value === null || half[i] === null ? null : value + sign * half[i]));
  return { label, colour, values, low: moved(-1), high: moved(1) };
}

// ---- the sphere of directions: azimuth to the right, elevation upwards, in degrees ----

const SVG = "http://www.w3.org/2000/svg";
const WHOLE = { x: -180, y: -90, width: 360, height: 180 };
const REGION_90 = Math.sqrt(4.605); // sigmas of the 90 % region of two values

function svgElement(name, attributes, parent) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  parent?.append(element);
  return element;
}

function dotPath(azimuth, elevation) {
  return azimuth.map((a, i) => (a === null ? "" : `M${a} ${-elevation[i]}h.01`)).join("");
}

function drawSphere(view, figure) {
  const { run } = view;
  const svg = svgElement("svg", { viewBox: "-180 -90 360 180", role: "img", "aria-label": "directions that things come from" }, figure);
  const fixed = svgElement("g", {}, svg), moving = svgElement("g", {}, svg);
  const thin = { fill: "none", "stroke-width": 1, "vector-effect": "non-scaling-stroke" };
  const dots = { fill: "none", "stroke-linecap": "round", "vector-effect": "non-scaling-stroke" };
  let box = { ...WHOLE };

  const paint = () => {
    fixed.replaceChildren();
    for (let a = -180; a <= 180; a += 30) svgElement("path", { d: `M${a} -90V90`, stroke: style("--line"), ...thin }, fixed);
    for (let e = -90; e <= 90; e += 30) svgElement("path", { d: `M-180 ${e}H180`, stroke: style("--line"), ...thin }, fixed);
    const border = run.outline[0].map((a, i) => `${a},${-run.outline[1][i]}`).join(" ");
    svgElement("polygon", { points: border, ...thin, stroke: style("--ink"), "stroke-width": 1.5 }, fixed);
    svgElement("path", { d: dotPath(run.frames.heading[0], run.frames.heading[1]), stroke: style("--muted"), ...dots, "stroke-width": 2.5 }, fixed);
    for (const object of run.objects)
      svgElement("path", { d: dotPath(...object.epipole), stroke: colourOf(object.colour), ...dots, "stroke-width": 4, opacity: 0.55 }, fixed);
    look();
  };

  // What is written keeps its size, so it is made anew whenever one looks closer.
  const look = () => {
    svg.setAttribute("viewBox", `${box.x} ${box.y} ${box.width} ${box.height}`);
    present(view.at);
  };

  const write = (text, x, y, colour, size) => {
    const element = svgElement("text", { x, y, fill: colour, "font-size": size * 1.4 }, moving);
    element.textContent = text;
  };

  const present = (at) => {
    moving.replaceChildren();
    const unit = box.width / 100;
    const ink = style("--ink"), muted = style("--muted");
    for (let a = -150; a <= 150; a += 30) write(`${a}°`, a, box.y + box.height - 0.5 * unit, muted, unit);
    for (let e = -60; e <= 60; e += 30) write(`${-e}°`, box.x + 0.5 * unit, e, muted, unit);
    const i = nearestPlace(run.frames.at, at);
    const [a, e] = [run.frames.heading[0][i], run.frames.heading[1][i]];
    if (a !== null) {
      svgElement("path", { d: `M${a - unit} ${-e}h${2 * unit}M${a} ${-e - unit}v${2 * unit}`, stroke: ink, ...thin, "stroke-width": 2.5 }, moving);
      write("we", a + 0.6 * unit, -e - 0.8 * unit, ink, unit);
    }
    run.objects.forEach((object, k) => {
      const row = view.rowAt[k].get(at);
      if (row === undefined) return;
      const colour = colourOf(object.colour);
      const [from, seen, error] = [object.epipole, object.bearing, object.epipole_error].map((columns) => columns.map((column) => column[row]));
      if (seen[0] !== null) svgElement("circle", { cx: seen[0], cy: -seen[1], r: 1.1 * unit, stroke: colour, ...thin, "stroke-width": 2.5 }, moving);
      if (from[0] === null) return;
      svgElement("circle", { cx: from[0], cy: -from[1], r: 0.6 * unit, fill: colour, stroke: ink, "stroke-width": 1, "vector-effect": "non-scaling-stroke" }, moving);
      if (error[0] !== null) svgElement("polyline", { points: ellipse(from, error), stroke: colour, ...thin, "stroke-width": 2 }, moving);
      write(object.id, from[0] + 0.8 * unit, -from[1] - 0.8 * unit, ink, unit);
    });
  };

  const pointAt = (event) => {
    const point = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
    return [point.x, point.y];
  };
  const moveTo = (next) => { box = next; look(); };

  svg.addEventListener("wheel", (event) => {
    event.preventDefault();
    const [x, y] = pointAt(event);
    const width = bounded(box.width * Math.exp(event.deltaY / 400), 4, WHOLE.width);
    const part = width / box.width;
    moveTo({ x: x + (box.x - x) * part, y: y + (box.y - y) * part, width, height: box.height * part });
  }, { passive: false });
  svg.addEventListener("dblclick", () => moveTo({ ...WHOLE }));
  let held = null;
  svg.addEventListener("pointerdown", (event) => { held = { from: pointAt(event), x: event.clientX, y: event.clientY, moved: false }; });
  svg.addEventListener("pointermove", (event) => {
    if (!held || !(event.buttons & 1)) return;
    held.moved ||= Math.hypot(event.clientX - held.x, event.clientY - held.y) > 4;
    const [x, y] = pointAt(event);
    if (held.moved) moveTo({ ...box, x: box.x + held.from[0] - x, y: box.y + held.from[1] - y });
  });
  svg.addEventListener("click", (event) => {
    const wasDrag = held?.moved;
    held = null;
    if (wasDrag) return;
    const [x, y] = pointAt(event);
    let best = { distance: FOUND_PX * box.width / svg.clientWidth, at: null };
    for (const object of run.objects) object.epipole[0].forEach((a, row) => {
      if (a === null) return;
      const distance = Math.hypot(a - x, -object.epipole[1][row] - y);
      if (distance < best.distance) best = { distance, at: object.at[row] };
    });
    if (best.at !== null) view.go(best.at);
  });
  view.listeners.push(present);
  view.repaint = paint;
  paint();
}

// The border of the 90 % region about a direction with errors (sigma, sigma, correlation).
function ellipse([a, e], [sigmaA, sigmaE, correlation]) {
  const points = [];
  for (let k = 0; k <= 36; k++) {
    const angle = (k * Math.PI) / 18;
    const u = Math.cos(angle), v = correlation * u + Math.sqrt(1 - correlation ** 2) * Math.sin(angle);
    points.push(`${a + REGION_90 * sigmaA * u},${-(e + REGION_90 * sigmaE * v)}`);
  }
  return points.join(" ");
}

// ---- the page ----

const views = [...document.querySelectorAll(".run")].map((section, i) => new RunView(section, data.runs[i]));
RunView.chosen = views[0];
for (const view of views) view.show(0);

function goTogether(leader) {
  if (!document.getElementById("together")?.checked) return;
  const t = leader.t[leader.at];
  for (const view of views) if (view !== leader) view.go(nearestPlace(view.t, t), false);
}

function nextWarning(view, direction) {
  const places = [...view.section.querySelectorAll("button.warning")].map((button) => placeOf(view.frame, Number(button.dataset.frame))).sort((a, b) => a - b);
  const found = direction > 0 ? places.find((at) => at > view.at) : places.findLast((at) => at < view.at);
  if (found !== undefined) view.go(found);
}

const KEYS = {
  ArrowLeft: (view, event) => (event.shiftKey ? view.pick(view.t[view.at] - 1) : view.go(view.at - 1)),
  ArrowRight: (view, event) => (event.shiftKey ? view.pick(view.t[view.at] + 1) : view.go(view.at + 1)),
  n: (view) => nextWarning(view, 1),
  p: (view) => nextWarning(view, -1),
  " ": (view) => view.video && (view.video.paused ? view.video.play() : view.video.pause()),
};
addEventListener("keydown", (event) => {
  const act = KEYS[event.key];
  // Keys that a control understands itself are its own; so are those of the browser.
  if (!act || event.ctrlKey || event.altKey || event.metaKey || event.target.closest("input, video, summary")) return;
  if (event.key === " " && event.target.closest("button, a")) return;
  event.preventDefault();
  act(RunView.chosen, event);
});

repaints.push(() => { for (const view of views) { view.colourEverything(); view.repaint(); } });
addEventListener("resize", () => { for (const view of views) view.show(view.at); });
