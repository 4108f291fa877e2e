// The live view: takes frames from /events and puts their series into figures made beforehand.
"use strict";

const token = document.querySelector("meta[name=token]").content;
const place = (path) => `${path}?token=${encodeURIComponent(token)}`;
const element = (id) => document.getElementById(id);
const DRAW_SHARE = 0.25; // of the time is spent on drawing, at most
const SHORTEST_PAUSE_MS = 50;
const STALLED_MS = 3000;
const ROOM = 1.1; // around an arm that has left its space

let frames = [];
let figures = {};
let run = {};
let lastFrameAt = 0;
let isOver = false;

function take(fresh) {
  for (const frame of fresh) {
    if (frames.length && frame.time_s < frames[frames.length - 1].time_s) frames = [];
    frames.push(frame);
    if (frame.arm) grow(figures.arm.layout.scene, frame.arm);
  }
  if (!fresh.length) return;
  lastFrameAt = performance.now();
  const begin = frames[frames.length - 1].time_s - run.window_s;
  frames = frames.slice(Math.max(0, frames.findIndex((frame) => frame.time_s >= begin)));
}

function fill(trace) {
  const { series, joint, lines, path } = trace.meta || {};
  if (series) {
    trace.x = frames.map((frame) => frame.time_s);
    trace.y = frames.map((frame) => (joint === undefined ? frame[series] : frame[series][joint]));
  } else if (lines) {
    Object.assign(trace, frames[frames.length - 1][lines] || { x: [], y: [], z: [] });
  } else if (path) {
    const tips = frames.map((frame) => frame[path]).filter(Boolean);
    for (const axis of "xyz") trace[axis] = tips.map((points) => points[axis].at(-1));
  }
  return trace;
}

// A cube stays one: it grows on all sides, as far as it must to hold all points.
function grow(scene, points) {
  let growth = 1;
  for (const axis of "xyz") {
    const [low, high] = scene[`${axis}axis`].range;
    for (const value of points[axis]) {
      if (value !== null) growth = Math.max(growth, Math.abs(2 * value - low - high) / (high - low));
    }
  }
  if (growth === 1) return;
  for (const axis of "xyz") {
    const [low, high] = scene[`${axis}axis`].range;
    const middle = (low + high) / 2, half = growth * ROOM * (high - low) / 2;
    scene[`${axis}axis`].range = [middle - half, middle + half];
  }
}

// A scene in space is seen whole in a square; where its card is narrower, from further away.
function stepBack(scene, place) {
  const farther = Math.max(1, place.clientHeight / place.clientWidth);
  for (const axis of "xyz") scene.camera.eye[axis] *= farther;
}

function draw() {
  const begun = performance.now();
  if (frames.length) {
    const end = frames[frames.length - 1].time_s;
    const range = [Math.max(0, end - run.window_s), Math.max(end, 0.1)];
    for (const [id, figure] of Object.entries(figures)) {
      for (const name of Object.keys(figure.layout)) {
        if (!/^xaxis\d*$/.test(name)) continue;
        figure.layout[name] = { ...figure.layout[name], range: [...range], autorange: false };
      }
      Plotly.react(id, figure.data.map(fill).map((trace) => ({ ...trace })), figure.layout);
    }
  }
  tell();
  const took = performance.now() - begun;
  document.body.dataset.frames = frames.length;
  setTimeout(draw, Math.max(SHORTEST_PAUSE_MS, took / DRAW_SHARE));
}

function tell() {
  const last = frames[frames.length - 1];
  const stalled = last && performance.now() - lastFrameAt > STALLED_MS;
  element("state").textContent = isOver ? "the run is over"
    : !last ? "waiting for the run" : stalled ? "nothing new" : "running";
  if (!last) return;
  element("time").textContent = `${last.time_s.toFixed(2)} of ${run.duration_s} s`;
  element("mode").textContent = last.mode || "–";
  let nearest = -1, usage = -1;
  last.error.forEach((error, joint) => {
    const used = error === null ? -1 : error >= 0 ? error / last.upper[joint] : error / last.lower[joint];
    if (used > usage) [usage, nearest] = [used, joint];
  });
  element("nearest").textContent =
    nearest < 0 ? "–" : `${run.joints[nearest]}, ${(100 * usage).toFixed(1)} % of it`;
  element("nearest").classList.toggle("bad", usage >= 1);
  element("deadlines").textContent = !last.ticks ? "–"
    : `${(100 * (1 - last.missed / last.ticks)).toFixed(2)} %, ${last.missed} of ${last.ticks} missed`;
  element("events").replaceChildren(...last.events.slice(-8).map((text) => {
    const item = document.createElement("li");
    item.textContent = text;
    return item;
  }));
}

async function start() {
  figures = await (await fetch(place("figures.json"))).json();
  run = await (await fetch(place("run.json"))).json();
  document.title = `${run.name} · live view`;
  element("about").textContent = `${run.name} · ${run.law} · ${run.source}`;
  for (const [id, figure] of Object.entries(figures)) {
    if (figure.layout.scene) stepBack(figure.layout.scene, element(id));
    await Plotly.newPlot(id, figure.data, figure.layout, { responsive: true, displayModeBar: false });
  }
  const source = new EventSource(place("events"));
  source.addEventListener("frames", (event) => take(JSON.parse(event.data)));
  source.addEventListener("over", () => { isOver = true; source.close(); });
  draw();
}

start();
