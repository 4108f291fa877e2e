"use strict";
const config = { displaylogo: false, showSendToCloud: false, modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"] };
const resized = new ResizeObserver((entries) => entries.forEach(({ target }) => target.clientWidth && Plotly.Plots.resize(target))); // not while it is folded

async function loadLibrary() {
  const packed = document.getElementById("library");
  if (packed) {
    const bytes = Uint8Array.from(atob(packed.textContent), (letter) => letter.charCodeAt(0));
    const unpacked = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    const script = document.createElement("script");
    script.textContent = await new Response(unpacked).text();
    document.head.append(script);
    packed.remove();
  }
  if (!window.Plotly) throw new Error("plotly.min.js, which draws the figures, has to lie where this page was written beside it");
}

function floats(packed) {
  const bytes = Uint8Array.from(atob(packed.bdata), (letter) => letter.charCodeAt(0));
  return new Float32Array(bytes.buffer);
}

/* A line in a figure over time, at the instant that is looked at; hovering sets the instant. */
function addCursor(plot, clock) {
  const line = plot.appendChild(document.createElement("div"));
  line.className = "cursor";
  const place = () => {
    const { xaxis, _size: size } = plot._fullLayout;
    const x = xaxis.l2p(clock.time_s);
    line.hidden = !(x >= 0 && x <= xaxis._length);
    Object.assign(line.style, { top: `${size.t}px`, height: `${size.h}px`, transform: `translateX(${xaxis._offset + x}px)` });
  };
  plot.on("plotly_afterplot", place);
  plot.addEventListener("pointermove", (event) => {
    const { xaxis } = plot._fullLayout;
    const x = event.clientX - plot.getBoundingClientRect().left - xaxis._offset;
    if (!clock.isPlaying && !event.buttons && x >= 0 && x <= xaxis._length) clock.set(xaxis.p2l(x));
  });
  clock.followers.push(place);
}

/* The arm in its figure, between the two frames around the instant that is looked at. */
function addMotion(plot, motion, clock) {
  const times = floats(motion.times), points = floats(motion.points);
  const ofTrace = 3 * motion.points_of_each, ofFrame = ofTrace * motion.traces;
  const traces = Array.from({ length: motion.traces }, (_, trace) => trace);
  let isSeen = false, isBusy = false, shown_s = times[0];
  const coordinate = (trace, axis) => {
    let next = times.findIndex((time) => time > shown_s);
    next = next < 0 ? times.length - 1 : Math.max(next, 1);
    const before = Math.max(next - 1, 0), span = times[next] - times[before];
    const share = span > 0 ? Math.min(Math.max((shown_s - times[before]) / span, 0), 1) : 0;
    return Array.from({ length: motion.points_of_each }, (_, point) => {
      const place = trace * ofTrace + 3 * point + axis;
      const value = (1 - share) * points[before * ofFrame + place] + share * points[next * ofFrame + place];
      return Number.isNaN(value) ? null : value;
    });
  };
  const move = async () => {
    if (!isSeen || isBusy || shown_s === clock.time_s) return;
    isBusy = true;
    shown_s = clock.time_s;
    const [x, y, z] = [0, 1, 2].map((axis) => traces.map((trace) => coordinate(trace, axis)));
    await Plotly.restyle(plot, { x, y, z }, traces);
    isBusy = false;
    move();
  };
  new IntersectionObserver(([entry]) => { isSeen = entry.isIntersecting; move(); }).observe(plot);
  clock.followers.push(move);
}

/* The bar at the foot of the page: one instant for all figures. Nothing moves until it is asked to,
   and for those who want little motion only once a second. */
function startClock(bar) {
  const [button, slider, output, speed] = ["button", "input", ".time", "select"].map((name) => bar.querySelector(name));
  const wantsLittleMotion = matchMedia("(prefers-reduced-motion: reduce)");
  const clock = { time_s: 0, isPlaying: false, followers: [], set };
  let reached_s = 0, last_ms = null;
  function set(time_s) {
    clock.time_s = reached_s = Math.min(Math.max(time_s, 0), Number(slider.max));
    tell();
  }
  function tell() {
    slider.value = clock.time_s;
    output.textContent = `${clock.time_s.toFixed(3)} s`;
    slider.setAttribute("aria-valuetext", output.textContent);
    clock.followers.forEach((follow) => follow());
  }
  function play(isPlaying) {
    clock.isPlaying = isPlaying;
    button.textContent = isPlaying ? "Pause" : "Play";
    last_ms = null;
    if (isPlaying && reached_s >= Number(slider.max)) set(0);
    if (isPlaying) requestAnimationFrame(advance);
  }
  function advance(now_ms) {
    if (!clock.isPlaying) return;
    if (last_ms !== null) reached_s = Math.min(reached_s + (now_ms - last_ms) * 1e-3 * Number(speed.value), Number(slider.max));
    last_ms = now_ms;
    const isOver = reached_s >= Number(slider.max);
    const shown_s = wantsLittleMotion.matches && !isOver ? Math.floor(reached_s) : reached_s;
    if (shown_s !== clock.time_s) { clock.time_s = shown_s; tell(); }
    if (isOver) play(false); else requestAnimationFrame(advance);
  }
  button.addEventListener("click", () => play(!clock.isPlaying));
  slider.addEventListener("input", () => { play(false); set(Number(slider.value)); });
  bar.hidden = false;
  return clock;
}

/* A scene in space is seen whole in a square; where the figure is narrower, from further away. */
function stepBack({ scene }, place) {
  const farther = Math.max(1, place.clientHeight / place.clientWidth);
  for (const axis of scene ? "xyz" : "") scene.camera.eye[axis] *= farther;
}

/* Colours of a figure on white, by what they are on a dark page; the others are read on both. */
const onDark = {
  "#1f2933": "#e3e8ee", "#7b8794": "#9aa6b2", "#e9edf1": "#2b333c", "#cbd2d9": "#4a545f", white: "#171c22", "#2a3f5f": "#e3e8ee", "#c3cad1": "#5b6672", "#9aa5b1": "#7d8995",
  "#0072b2": "#4aa3df", "#d55e00": "#f08a3c", "#009e73": "#35c495", "#a3508b": "#d488bd", "#b07d00": "#d9a92b", "#3a9bd9": "#a5d8f8", "#5b5b5b": "#a9a9a9",
  "rgba(0,114,178,0.11)": "rgba(74,163,223,0.2)",
};
const scheme = matchMedia("screen and (prefers-color-scheme: dark)");
scheme.addEventListener("change", () => location.reload());

function readFigure(text) {
  return JSON.parse(text, (_, value) => (scheme.matches && Object.hasOwn(onDark, value) ? onDark[value] : value));
}

async function draw(source, clock) {
  const figure = readFigure(source.textContent), id = source.dataset.plot;
  stepBack(figure.layout, document.getElementById(id));
  const plot = await Plotly.newPlot(id, figure.data, figure.layout, config);
  resized.observe(plot);
  plot.on("plotly_click", ({ points: [point] }) => {
    const shown = plot.parentElement.querySelector("output");
    if (shown && point.customdata) shown.textContent = point.customdata;
  });
  if (clock && "time" in source.dataset) addCursor(plot, clock);
  const motion = document.querySelector(`script[data-motion="${id}"]`);
  if (clock && motion) addMotion(plot, JSON.parse(motion.textContent), clock);
}

async function drawAll() {
  const sources = document.querySelectorAll("script[data-plot]");
  if (!sources.length) return;
  await loadLibrary();
  const bar = document.getElementById("clock"), clock = bar && startClock(bar);
  for (const source of sources) await draw(source, clock);
  if (clock) clock.set(0);
}

// A click on a heading sorts the rows of its table: numbers by size, a second click turns them round.
function sortBy(heading) {
  const body = heading.closest("table").tBodies[0], column = heading.cellIndex;
  const falls = heading.getAttribute("aria-sort") === "ascending";
  for (const each of heading.parentElement.cells) each.removeAttribute("aria-sort");
  heading.setAttribute("aria-sort", falls ? "descending" : "ascending");
  const text = (row) => row.cells[column].textContent.trim();
  const value = (row) => parseFloat(text(row).replaceAll(",", "").replace("−", "-"));
  const order = (a, b) => {
    const [x, y] = [value(a), value(b)];
    if (isNaN(x) || isNaN(y)) return isNaN(x) - isNaN(y) || text(a).localeCompare(text(b));
    return x - y;
  };
  const rows = [...body.rows].sort(order);
  body.append(...(falls ? rows.reverse() : rows));
}

for (const heading of document.querySelectorAll("thead th")) {
  heading.tabIndex = 0;
  heading.title = "Sort by this column";
  heading.addEventListener("click", () => sortBy(heading));
  heading.addEventListener("keydown", (event) => { if (event.key === "Enter") sortBy(heading); });
}

drawAll().catch((error) => {
  const message = document.getElementById("no-figures");
  message.textContent = `The figures cannot be drawn: ${error.message}.`;
  message.hidden = false;
});
