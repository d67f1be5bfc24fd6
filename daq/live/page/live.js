"use strict";
// The live view: draws what the server sends.  Samples are kept for as long as the longest window.

const BLUE = "#0072b2", RED = "#d55e00", GREY = "#8a8a90", INK = "#1d1d1f"; // Okabe and Ito's, distinct to colour-blind readers too
const KEEP_S = 120, FRAME_MS = 40, MOST_FRICTION = 12000;
const HALF_MS = 50; // between messages 100 ms pass: the second half of the samples is drawn so long after the first
const element = (id) => document.getElementById(id);
const samples = { t: [], x: [], v: [], a: [] };
const markers = [];
let facts = null, latest = null, ended = "", paused = false, pausedAt = null, dirty = false, frames = 0;
let waiting = null; // a message whose second half is not among the samples yet

function cut(limit) {
  let first = 0;
  while (first < samples.t.length && samples.t[first] < limit) first++;
  if (first > samples.t.length / 4) for (const name in samples) samples[name].splice(0, first);
}

function take(message, from, to) {
  for (const name in samples) for (let i = from; i < to; i++) samples[name].push(message[name][i]);
  if (samples.t.length) cut(samples.t[samples.t.length - 1] - KEEP_S);
  dirty = true;
}

const middle = (message) => Math.ceil(message.t.length / 2);

function takeRest() {
  if (!waiting) return;
  const message = waiting;
  waiting = null;
  take(message, middle(message), message.t.length);
}

function receive(event) {
  takeRest();
  const message = JSON.parse(event.data);
  if (message.marker) markers.push(message.marker);
  if (message.ended) { ended = message.ended; source.close(); showState(); }
  if (message.t) {
    latest = waiting = message;
    take(message, 0, middle(message));
    setTimeout(takeRest, HALF_MS);
  }
  dirty = true;
}

function showState() {
  const words = ended || (source.readyState === EventSource.OPEN ? (latest ? latest.state : "waiting") : facts ? "reconnecting" : "connecting");
  const state = element("state");
  state.dataset.state = ended ? "ended" : source.readyState === EventSource.OPEN && latest ? latest.state : "lost";
  if (state.textContent !== words) state.textContent = words;
}

function showFacts() {
  if (!latest || !samples.t.length) return;
  const now = samples.t[samples.t.length - 1];
  element("elapsed").textContent = now.toFixed(1) + " s";
  if (facts && facts.duration) element("remaining").textContent = Math.max(0, facts.duration - now).toFixed(1) + " s";
  for (const [name, number] of Object.entries(latest.counts)) {
    const field = element(name);
    field.textContent = number;
    field.classList.toggle("wrong", number > 0 && !["samples", "segments"].includes(name));
  }
}

// ---- drawing ---------------------------------------------------------------------------------------------------

function padded(low, high) {
  if (!(low < high)) { const half = Math.abs(low) * 0.05 || 1; return [low - half, low + half]; }
  const margin = 0.05 * (high - low);
  return [low - margin, high + margin];
}

function extent(values, from) {
  let low = Infinity, high = -Infinity;
  for (let i = from; i < values.length; i++) {
    const value = values[i];
    if (value === null) continue;
    if (value < low) low = value;
    if (value > high) high = value;
  }
  return [low, high];
}

const axis = (label, more) => ({ label, labelSize: 22, stroke: INK, grid: { stroke: "#ececf0" }, ...more });
const free = { auto: false, range: (u, low, high) => [low, high] }; // a scale that draw() sets
const ALONG = { size: 34 }, UP = { size: 54 };

function makePlot(id, height, options) {
  const box = element(id);
  const plot = new uPlot({
    width: box.clientWidth, height, legend: { show: false }, cursor: { show: false }, ...options,
  }, options.data, box);
  new ResizeObserver(() => plot.setSize({ width: box.clientWidth, height: plot.height })).observe(box);
  return plot;
}

// uPlot draws lines over increasing x alone: the two XY pictures draw their own points on its canvas and axes.
function makeXY(id, label, draw) {
  return makePlot(id, Math.max(240, Math.min(360, window.innerHeight / 2.6)), {
    data: [[0, 1], [null, null]],
    scales: { x: { time: false, ...free }, y: free },
    axes: [axis(label[0], ALONG), axis(label[1], UP)],
    series: [{}, { show: false }],
    hooks: { draw: [draw] },
  });
}

const view = { scale: 1, unit: "m" }; // what is shown of lengths: mm for m; speeds are in m/s
const lengths = (unit) => unit === "m" ? { scale: 1e3, length: "mm", speed: "m/s" } : { scale: 1, length: "counts", speed: "counts/s" };

const trace = makePlot("trace", Math.max(220, Math.min(320, window.innerHeight / 3)), {
  data: [[], [], []],
  scales: { x: { time: false, ...free }, y: free, w: free },
  axes: [
    axis("time (s)", ALONG), axis("position", { ...UP, stroke: BLUE }),
    axis("velocity", { ...UP, scale: "w", side: 1, stroke: RED, grid: { show: false } }),
  ],
  series: [{}, { stroke: BLUE, width: 1.5, points: { show: false } }, { scale: "w", stroke: RED, width: 1.2, points: { show: false } }],
  hooks: { draw: [drawMarkers] },
});

function drawMarkers(u) {
  const ctx = u.ctx;
  ctx.save();
  ctx.strokeStyle = ctx.fillStyle = INK;
  ctx.font = `${12 * devicePixelRatio}px system-ui, sans-serif`; ctx.textAlign = "left"; ctx.textBaseline = "top";
  for (const marker of markers) {
    if (marker.t < u.scales.x.min || marker.t > u.scales.x.max) continue;
    const at = u.valToPos(marker.t, "x", true);
    ctx.beginPath(); ctx.moveTo(at, u.bbox.top); ctx.lineTo(at, u.bbox.top + u.bbox.height); ctx.stroke();
    ctx.fillText(marker.text, at + 4, u.bbox.top + 2);
  }
  ctx.restore();
}

let shown = { first: 0, friction: [] };

const portrait = makeXY("portrait", ["position", "velocity"], (u) => {
  const { x, v, t } = samples, ctx = u.ctx, [px, py] = [pixels(u, "x"), pixels(u, "y")];
  ctx.save(); clip(u); ctx.lineWidth = 1.3 * devicePixelRatio; ctx.strokeStyle = BLUE;
  ctx.beginPath();
  let joined = false;
  for (let i = shown.first; i < t.length; i++) {
    if (v[i] === null) { joined = false; continue; }
    if (joined) ctx.lineTo(px(x[i] * view.scale), py(v[i]));
    else ctx.moveTo(px(x[i] * view.scale), py(v[i]));
    joined = true;
  }
  ctx.stroke();
  if (latest && latest.belt !== null) level(u, py(latest.belt), "belt");
  const last = t.length - 1;
  if (last >= 0 && v[last] !== null) dot(ctx, px(x[last] * view.scale), py(v[last]));
  ctx.restore();
});

const friction = makeXY("friction", ["relative velocity", "friction"], (u) => {
  const ctx = u.ctx, [px, py] = [pixels(u, "x"), pixels(u, "y")], size = 2 * devicePixelRatio;
  ctx.save(); clip(u); ctx.fillStyle = "rgba(0, 114, 178, 0.35)";
  for (const [w, f] of shown.friction) ctx.fillRect(px(w) - size / 2, py(f) - size / 2, size, size);
  ctx.restore();
});

// From a value to its pixel: as valToPos, which costs too much for every point.
function pixels(u, key) {
  const { min, max } = u.scales[key];
  const [low, high] = key === "x" ? [u.bbox.left, u.bbox.left + u.bbox.width] : [u.bbox.top + u.bbox.height, u.bbox.top];
  return (value) => low + (high - low) * (value - min) / (max - min);
}

function clip(u) { u.ctx.beginPath(); u.ctx.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height); u.ctx.clip(); }

function level(u, at, words) {
  const ctx = u.ctx;
  ctx.setLineDash([6, 4]); ctx.strokeStyle = ctx.fillStyle = GREY; ctx.beginPath();
  ctx.moveTo(u.bbox.left, at); ctx.lineTo(u.bbox.left + u.bbox.width, at); ctx.stroke();
  ctx.font = `${12 * devicePixelRatio}px system-ui, sans-serif`; ctx.textAlign = "center"; ctx.textBaseline = "top";
  ctx.fillText(words, u.bbox.left + u.bbox.width / 2, at + 4); ctx.setLineDash([]); // within the orbit, not on its edge
}

function dot(ctx, x, y) { ctx.fillStyle = RED; ctx.beginPath(); ctx.arc(x, y, 5 * devicePixelRatio, 0, 7); ctx.fill(); }

// Friction per mass is a + k/m x (+ c/m v); with the mass known it is in N.
function frictionPoints() {
  const { x, v, a } = samples, found = [];
  if (!latest || latest.k_over_m === null || latest.belt === null) return found;
  const mass = latest.mass || 1, drag = latest.mass && latest.damping ? latest.damping : 0;
  const step = Math.max(1, Math.ceil(x.length / MOST_FRICTION));
  for (let i = 0; i < x.length; i += step) {
    if (v[i] === null) continue;
    found.push([latest.belt - v[i], mass * (a[i] + latest.k_over_m * x[i]) + drag * v[i]]);
  }
  return found;
}

function setRange(plot, key, low, high) {
  if (element("lock").checked || low > high) return;
  const [min, max] = padded(low, high);
  plot.setScale(key, { min, max });
}

function draw() {
  if (!samples.t.length) return;
  const names = lengths(latest.unit);
  view.scale = names.scale;
  const span = Number(element("window").value), now = samples.t[samples.t.length - 1];
  let first = samples.t.length - 1;
  while (first > 0 && samples.t[first] > now - span) first--;
  shown.first = first;
  const position = samples.x.slice(first).map((value) => value === null ? null : value * view.scale);
  const data = [samples.t.slice(first), position, samples.v.slice(first)];
  label(trace, 1, `position (${names.length})`); label(trace, 2, `velocity (${names.speed})`);
  label(portrait, 0, `position (${names.length})`); label(portrait, 1, `velocity (${names.speed})`);
  label(friction, 0, `relative velocity: belt minus mass (${names.speed})`);
  label(friction, 1, latest.mass ? "friction (N)" : latest.unit === "m" ? "friction / mass (m/s²)" : "friction / mass (counts/s²)");
  const [xLow, xHigh] = extent(data[1], 0), [vLow, vHigh] = extent(data[2], 0);
  trace.batch(() => {
    trace.setData(data, false);
    trace.setScale("x", { min: Math.max(samples.t[0], now - span), max: Math.max(now, samples.t[0] + Math.min(span, 1)) });
    setRange(trace, "y", xLow, xHigh); setRange(trace, "w", vLow, vHigh);
  });
  portrait.batch(() => { setRange(portrait, "x", xLow, xHigh); setRange(portrait, "y", vLow, vHigh); portrait.redraw(false); });
  if (frames % 5 === 0) {
    shown.friction = frictionPoints();
    const title = element("friction-title");
    const without = latest.belt === null ? "the belt speed" : latest.k_over_m === null ? "k/m" : "";
    title.textContent = "friction against relative velocity" + (without ? `: waits for ${without}, estimated from the first slips` : "");
    if (shown.friction.length) {
      const w = extent(shown.friction.map((one) => one[0]), 0), f = extent(shown.friction.map((one) => one[1]), 0);
      friction.batch(() => { setRange(friction, "x", ...w); setRange(friction, "y", ...f); friction.redraw(false); });
    }
  }
  frames++;
  document.body.dataset.frames = frames;
}

function label(plot, index, text) { plot.axes[index].label = text; }

let drawn = 0;
function tick(now) {
  showState();
  if (dirty && !paused && now - drawn >= FRAME_MS) { drawn = now; dirty = false; showFacts(); draw(); }
  else if (dirty && paused) showFacts();
  requestAnimationFrame(tick);
}

// ---- controls --------------------------------------------------------------------------------------------------

function pause() {
  paused = !paused;
  element("pause").setAttribute("aria-pressed", String(paused));
  element("pause").textContent = paused ? "go on" : "pause";
  dirty = true;
}

async function mark(event) {
  if (event) event.preventDefault();
  const words = element("words");
  try {
    const answer = await fetch("marker", { method: "POST", headers: { "Content-Type": "text/plain" }, body: words.value || "marker" });
    if (!answer.ok) throw new Error(await answer.text());
    words.value = "";
  } catch (error) { element("state").textContent = `marker not stored: ${error.message}`; }
}

function save() {
  const plots = [trace, portrait, friction], gap = 16 * devicePixelRatio;
  const sheet = document.createElement("canvas");
  sheet.width = Math.max(...plots.map((plot) => plot.ctx.canvas.width));
  sheet.height = plots.reduce((sum, plot) => sum + plot.ctx.canvas.height + gap, 0);
  const ctx = sheet.getContext("2d");
  ctx.fillStyle = "#fff"; ctx.fillRect(0, 0, sheet.width, sheet.height);
  let at = 0;
  for (const plot of plots) { ctx.drawImage(plot.ctx.canvas, 0, at); at += plot.ctx.canvas.height + gap; }
  const link = document.createElement("a");
  link.download = (facts ? facts.file.replace(/\.h5$/, "") : "run") + "-live.png";
  link.href = sheet.toDataURL("image/png");
  link.click();
}

element("pause").addEventListener("click", pause);
element("controls").addEventListener("submit", mark);
element("save").addEventListener("click", save);
element("window").addEventListener("change", () => { dirty = true; });
document.addEventListener("keydown", (event) => {
  if (event.target.matches("input[type=text], select") || event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key === " " && !event.target.matches("button, input")) { event.preventDefault(); pause(); }
  else if (event.key === "a") element("lock").click();
  else if (event.key === "m") mark();
  else if (event.key === "s") save();
});

const source = new EventSource("events");
source.addEventListener("facts", (event) => {
  facts = JSON.parse(event.data);
  document.title = `${facts.file}: live`;
  element("title").textContent = `${facts.file}: ${facts.title}`;
  element("rate").textContent = `${facts.rate} Hz` + (facts.every > 1 ? `, every ${facts.every}th drawn` : "");
});
source.addEventListener("message", receive);
source.addEventListener("error", showState);
requestAnimationFrame(tick);
