"use strict";
// The three pictures, drawn by uPlot; and their cursors.

const FRICTION_POINTS = 3000, PORTRAIT_POINTS = 2500;
const colours = {}; // of the theme, by name
const scale = { length: 1e3, unit: "mm", speed: "m/s" }; // what is shown of lengths: mm for m; speeds are in m/s

// Custom properties are not resolved until something is coloured with them.
function readColours() {
  const probe = document.body.appendChild(document.createElement("i"));
  for (const name of ["ink", "quiet", "line", "paper", "x", "v", "f", "old"]) {
    probe.style.color = `var(--${name})`;
    colours[name] = getComputedStyle(probe).color;
  }
  probe.remove();
}
readColours();

// Numbers beside an axis, with the digits that tell neighbours apart.
function beside(u, splits) {
  const shownSplits = splits.filter((value) => value !== null);
  const step = shownSplits.length > 1 ? Math.abs(shownSplits[1] - shownSplits[0]) : 1, decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  return splits.map((value) => value === null ? null : value.toFixed(/[1-9]/.test((step * 10 ** decimals).toFixed(1).split(".")[1]) ? decimals + 1 : decimals));
}
const roomFor = (u, texts) => 20 + 8 * Math.ceil(Math.max(3, ...(texts || []).map((text) => text ? text.length : 0)) * 0.9);

const axis = (label, colour, more, filter = (u, splits) => splits) => ({
  label, labelSize: 20, labelGap: 0, values: beside, stroke: () => colours[colour], filter,
  grid: { stroke: () => colours.line, width: 1, filter }, ticks: { stroke: () => colours.line, width: 1, filter }, ...more,
});
const free = { auto: false, range: (u, low, high) => [low, high] }; // a scale that is set by hand
const ALONG = { size: 32, space: 60 }, UP = { size: roomFor };

function makePlot(id, height, options) {
  const box = element(id);
  const plot = new uPlot({ width: box.clientWidth, height, legend: { show: false }, ...options }, options.data, box);
  new ResizeObserver(() => { if (box.clientWidth && box.clientWidth !== plot.width) plot.setSize({ width: box.clientWidth, height: plot.height }); }).observe(box);
  return plot;
}

// Position is drawn in the upper half of the trace, velocity in the lower: an axis has numbers in its half alone.
function inHalf(upper) {
  return (u, splits, index) => {
    const { min, max } = u.scales[u.axes[index].scale];
    return splits.map((value) => (value >= (min + max) / 2) === upper ? value : null);
  };
}

const shown = { rows: null, t: [], origin: 0 }; // what is drawn now; times are from the origin

const trace = makePlot("trace", Math.max(210, Math.min(320, window.innerHeight / 3)), {
  data: [[], [], []],
  scales: { x: { time: false, ...free }, y: free, w: free },
  axes: [
    axis("time (s)", "ink", ALONG), axis("position", "x", UP, inHalf(true)),
    axis("velocity", "v", { ...UP, scale: "w", side: 1 }, inHalf(false)),
  ],
  series: [
    {},
    { stroke: () => colours.x, width: 1.5, points: { show: false }, spanGaps: false },
    { scale: "w", stroke: () => colours.v, width: 1.2, points: { show: false }, spanGaps: false },
  ],
  cursor: {
    y: false, points: { size: 8 }, dataIdx: (u, series, index, x) => isFar(u, u.data[0][index] - x) ? null : index, drag: { x: true, y: false, setScale: false },
    bind: { dblclick: () => () => { resetZoom(); return null; } },
  },
  hooks: {
    drawSeries: [(u, index) => { if (index === 1) drawEarlier(u); }],
    draw: [drawMarkers],
    setCursor: [showCursor],
    setSelect: [(u) => {
      const { left, width } = u.select;
      if (width < 8) return;
      const [from, to] = [u.posToVal(left, "x"), u.posToVal(left + width, "x")];
      u.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
      zoomTo(from + shown.origin, to + shown.origin);
    }],
  },
});

// uPlot draws lines over increasing x alone: the two XY pictures draw their own points on its canvas and axes.
function makeXY(id, label, draw) {
  const hover = (u) => {
    const { left, top } = u.cursor, inside = left >= 0 && top >= 0;
    element(`${id}-at`).textContent = inside ? told[id](u.posToVal(left, "x"), u.posToVal(top, "y")) : "";
  };
  return makePlot(id, Math.max(240, Math.min(340, window.innerHeight / 2.6)), {
    data: [[0, 1], [null, null]],
    scales: { x: { time: false, ...free }, y: free },
    axes: [axis(label[0], "ink", ALONG), axis(label[1], "ink", UP)],
    series: [{}, { show: false }],
    cursor: { drag: { x: false, y: false }, points: { show: false } },
    hooks: { draw: [draw], setCursor: [hover] },
  });
}

// So many digits, zeros at the end too.
function digits(value, most = 4) {
  if (!Number.isFinite(value)) return "–";
  if (value && (Math.abs(value) >= 1e6 || Math.abs(value) < 1e-4)) return value.toExponential(most - 1);
  return value.toFixed(Math.max(0, value ? most - 1 - Math.floor(Math.log10(Math.abs(value))) : most - 1));
}

// A value to a ten-thousandth of what its axis shows.
function onAxis(plot, key, value) {
  const { min, max } = plot.scales[key];
  if (!Number.isFinite(value)) return "–";
  const text = value.toFixed(Math.min(12, Math.max(0, Math.ceil(4 - Math.log10(max - min)))));
  return /[1-9]/.test(text) ? text : text.replace("-", "");
}

const told = {
  portrait: (x, v) => `x ${onAxis(portrait, "x", x)} ${scale.unit}, v ${onAxis(portrait, "y", v)} ${scale.speed}`,
  friction: (w, f) => `relative speed ${onAxis(friction, "x", w)} ${scale.speed}, F ${onAxis(friction, "y", f)}`,
};

// From a value to its pixel: as valToPos, which costs too much for every point.
function pixels(u, key) {
  const { min, max } = u.scales[key];
  const [low, high] = key === "x" ? [u.bbox.left, u.bbox.left + u.bbox.width] : [u.bbox.top + u.bbox.height, u.bbox.top];
  const factor = (high - low) / (max - min);
  return (value) => low + factor * (value - min);
}

function clip(u) { u.ctx.beginPath(); u.ctx.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height); u.ctx.clip(); }

// Text over curves, with a seam of paper around it.
function write(ctx, text, x, y) {
  ctx.save(); ctx.setLineDash([]);
  ctx.strokeStyle = colours.paper; ctx.lineWidth = 4 * devicePixelRatio; ctx.lineJoin = "round";
  ctx.strokeText(text, x, y);
  ctx.restore();
  ctx.fillText(text, x, y);
}

function font(ctx) { ctx.font = `${12 * devicePixelRatio}px system-ui, sans-serif`; }

function polyline(ctx, px, py, xs, ys, part, xFactor, step) {
  ctx.beginPath();
  let joined = false;
  for (let i = part.first; i < part.last; i++) {
    const y = ys[i];
    if (y !== y) joined = false;
    else if (joined && i % step === 0) ctx.lineTo(px(xs[i] * xFactor), py(y));
    else if (!joined) { ctx.moveTo(px(xs[i] * xFactor), py(y)); joined = true; }
  }
  ctx.stroke();
}

function drawMarkers(u) {
  const { ctx } = u;
  ctx.save(); clip(u); font(ctx);
  ctx.strokeStyle = ctx.fillStyle = colours.ink; ctx.textAlign = "left"; ctx.textBaseline = "top";
  for (const marker of [...markers, ...marked]) {
    const t = marker.t - shown.origin;
    if (t < u.scales.x.min || t > u.scales.x.max) continue;
    const at = u.valToPos(t, "x", true);
    ctx.setLineDash(marker.text ? [] : [3 * devicePixelRatio, 3 * devicePixelRatio]);
    ctx.beginPath(); ctx.moveTo(at, u.bbox.top); ctx.lineTo(at, u.bbox.top + u.bbox.height); ctx.stroke();
    write(ctx, marker.text, at + 4 * devicePixelRatio, u.bbox.top + 2);
  }
  ctx.restore();
}

// At a break-away: the earlier ones lie under the last one, as on the screen of an oscilloscope.
function drawEarlier(u) {
  if (!shown.earlier || !shown.earlier.length) return;
  const { ctx } = u, px = pixels(u, "x"), py = pixels(u, "y");
  ctx.save(); clip(u); ctx.strokeStyle = colours.old; ctx.lineWidth = devicePixelRatio;
  for (const [part, origin] of shown.earlier) {
    const step = Math.max(1, Math.ceil((part.last - part.first) / 800));
    polyline(ctx, (t) => px(t - origin), (x) => py(x * scale.length), part.t, part.x, part, 1, step);
  }
  ctx.restore();
}

const portrait = makeXY("portrait", ["position", "velocity"], (u) => {
  const part = shown.rows;
  if (!part) return;
  const { ctx } = u, [px, py] = [pixels(u, "x"), pixels(u, "y")];
  ctx.save(); clip(u);
  ctx.lineWidth = 1.3 * devicePixelRatio; ctx.strokeStyle = ctx.fillStyle = colours.x;
  const size = 2 * devicePixelRatio;
  const step = Math.max(1, Math.ceil((part.last - part.first) / PORTRAIT_POINTS));
  // Extremes of a long stretch are no orbit: they are points of it.
  if (!part.exact) for (let i = part.first; i < part.last; i += step) ctx.fillRect(px(part.x[i] * scale.length), py(part.v[i]), size, size);
  else polyline(ctx, px, py, part.x, part.v, part, scale.length, step);
  if (summary && summary.belt.value !== null) level(u, py(summary.belt.value), "belt");
  const last = part.last - 1;
  if (following() && part.v[last] === part.v[last]) {
    ctx.fillStyle = colours.v; ctx.beginPath(); ctx.arc(px(part.x[last] * scale.length), py(part.v[last]), 5 * devicePixelRatio, 0, 7); ctx.fill();
  }
  ctx.restore();
});

function level(u, at, words) {
  const { ctx } = u;
  font(ctx); ctx.setLineDash([6, 4].map((one) => one * devicePixelRatio)); ctx.strokeStyle = ctx.fillStyle = colours.quiet; ctx.lineWidth = devicePixelRatio;
  ctx.beginPath(); ctx.moveTo(u.bbox.left, at); ctx.lineTo(u.bbox.left + u.bbox.width, at); ctx.stroke();
  const under = at < u.bbox.top + u.bbox.height / 2; // within the orbit, not on its edge
  ctx.textAlign = "center"; ctx.textBaseline = under ? "top" : "bottom";
  write(ctx, words, u.bbox.left + u.bbox.width / 2, at + (under ? 5 : -5) * devicePixelRatio);
}

// As in the report: relative speed is positive in a slip, and friction where it pulls the mass along with the belt.
const forward = () => Math.sign(summary.belt.value) || 1;
const relativeSpeed = (v) => forward() * (summary.belt.value - v);
function force(x, v, a) {
  const { mass, k_over_m, x0, c_over_m } = summary.balance;
  return forward() * (mass ?? 1) * (a + k_over_m * (x - x0) + c_over_m * v);
}
const hasFriction = () => summary && summary.friction && summary.belt.value !== null;

const friction = makeXY("friction", ["relative speed", "friction"], (u) => {
  if (!hasFriction()) return;
  const { ctx } = u, [px, py] = [pixels(u, "x"), pixels(u, "y")], one = devicePixelRatio;
  const { speed, F, sd, break_away, break_away_sd } = summary.friction;
  ctx.save(); clip(u);
  ctx.fillStyle = colours.x; ctx.globalAlpha = 0.35;
  for (const [at, f] of shown.cloud || []) ctx.fillRect(px(at) - one, py(f) - one, 2 * one, 2 * one);
  ctx.globalAlpha = 1; ctx.strokeStyle = ctx.fillStyle = colours.f; ctx.lineWidth = 1.5 * one;
  ctx.beginPath();
  speed.forEach((at, i) => ctx.lineTo(px(at), py(F[i])));
  ctx.stroke();
  ctx.beginPath();
  speed.forEach((at, i) => { if (sd[i] !== null) { ctx.moveTo(px(at), py(F[i] - sd[i])); ctx.lineTo(px(at), py(F[i] + sd[i])); } });
  ctx.stroke();
  speed.forEach((at, i) => { ctx.beginPath(); ctx.arc(px(at), py(F[i]), 2.5 * one, 0, 7); ctx.fill(); });
  if (break_away !== null) {
    const at = px(0), y = py(break_away), half = break_away_sd === null ? 0 : py(0) - py(break_away_sd);
    ctx.strokeStyle = ctx.fillStyle = colours.v;
    ctx.beginPath(); ctx.moveTo(at, y - half); ctx.lineTo(at, y + half); ctx.stroke();
    ctx.beginPath(); ctx.moveTo(at, y - 6 * one); ctx.lineTo(at + 6 * one, y); ctx.lineTo(at, y + 6 * one); ctx.lineTo(at - 6 * one, y); ctx.fill();
  }
  ctx.restore();
});

// ---- what is drawn ----------------------------------------------------------------------------------------------

function padded(low, high) {
  if (!(low < high)) { const half = Math.abs(low) * 0.05 || 1; return [low - half, low + half]; }
  const margin = 0.05 * (high - low);
  return [low - margin, high + margin];
}

function extent(values) {
  let low = Infinity, high = -Infinity;
  for (const value of values) {
    if (value < low) low = value;
    if (value > high) high = value;
  }
  return [low, high];
}

// The values take a part of the scale: `below` and `above` are free room, in heights of the values.
function setRange(plot, key, low, high, below = 0, above = 0) {
  if (element("lock").checked || !(low <= high)) return;
  const [min, max] = padded(low, high), height = max - min;
  plot.setScale(key, { min: min - below * height, max: max + above * height });
}

// Columns for the trace: at most two rows a pixel, the extremes of what falls on it; null where nothing connects.
function columns(part, origin) {
  const t = [], x = [], v = [];
  const n = part.last - part.first, bucket = Math.max(1, Math.floor(n / (2 * trace.bbox.width / devicePixelRatio)));
  // Buckets begin at the same samples from frame to frame: extremes do not flicker.
  const start = part.first - (part.first + (part.base || 0)) % bucket;
  for (let i = Math.max(0, start); i < part.last; i += bucket) {
    const stop = Math.min(i + bucket, part.last);
    if (bucket === 1) { push(t, x, v, part, i, origin); continue; }
    let low = i, high = i, slow = i, fast = i;
    for (let k = i; k < stop; k++) {
      if (part.x[k] !== part.x[k]) { push(t, x, v, part, k, origin); low = high = slow = fast = Math.min(k + 1, stop - 1); continue; }
      if (part.x[k] < part.x[low]) low = k; else if (part.x[k] > part.x[high]) high = k;
      if (!(part.v[k] >= part.v[slow])) slow = k; else if (!(part.v[k] <= part.v[fast])) fast = k;
    }
    for (const k of new Set([low, high, slow, fast].sort((a, b) => a - b))) push(t, x, v, part, k, origin);
  }
  return [t, x, v];
}

function push(t, x, v, part, i, origin) {
  t.push(part.t[i] - origin);
  x.push(part.x[i] === part.x[i] ? part.x[i] * scale.length : null);
  v.push(part.v[i] === part.v[i] ? part.v[i] : null);
}

// Friction of the samples shown, less those about a break-away or a landing: parabolas round the corners there.
function cloudOf(part) {
  const found = [], step = Math.max(1, Math.ceil((part.last - part.first) / FRICTION_POINTS)), { half_s } = summary;
  let next = part.last > part.first ? place(breakAways.map(([, , landing]) => landing), part.t[part.first] - half_s) : 0;
  for (let i = part.first; i < part.last; i += step) {
    while (next < breakAways.length && breakAways[next][2] + half_s < part.t[i]) next++;
    const [from, , to] = breakAways[next] || [Infinity, 0, Infinity];
    if (Math.abs(part.t[i] - from) < half_s || Math.abs(part.t[i] - to) < half_s) continue;
    if (part.v[i] === part.v[i]) found.push([relativeSpeed(part.v[i]), force(part.x[i], part.v[i], part.a[i])]);
  }
  return found;
}

function label(plot, index, text) { plot.axes[index].label = text; }

function drawAll(part, from, to, origin, earlier, withFriction) {
  Object.assign(shown, { rows: part, origin, earlier });
  drawUnit();
  const data = columns(part, origin);
  label(trace, 0, origin ? "time since the break-away (s)" : "time (s)");
  label(trace, 1, `position (${scale.unit})`); label(trace, 2, `velocity (${scale.speed})`);
  label(portrait, 0, `position (${scale.unit})`); label(portrait, 1, `velocity (${scale.speed})`);
  const [xLow, xHigh] = extent(data[1].filter((value) => value !== null)), [vLow, vHigh] = extent(data[2].filter((value) => value !== null));
  trace.batch(() => {
    trace.setData(data, false);
    trace.setScale("x", { min: from - origin, max: to - origin });
    setRange(trace, "y", xLow, xHigh, 1); setRange(trace, "w", vLow, vHigh, 0, 1);
  });
  portrait.batch(() => { setRange(portrait, "x", xLow, xHigh); setRange(portrait, "y", vLow, vHigh); portrait.redraw(false); });
  if (withFriction) drawFriction(part);
  showCursor();
}

function drawFriction(part) {
  const title = element("friction-title");
  if (!hasFriction()) { title.textContent = "friction curve: needs three slips between sticks"; return; }
  const { mass, level_known } = summary.balance, { speed, F, sd, slips } = summary.friction;
  title.textContent = `friction curve, ${slips} slip${slips === 1 ? "" : "s"}`;
  label(friction, 0, `relative speed (${scale.speed})`);
  const quantity = mass !== null ? "friction" : "friction / mass", unit = mass !== null ? "N" : scale.unit === "mm" ? "m/s²" : "counts/s²";
  label(friction, 1, level_known ? `${quantity} (${unit})` : `${quantity} + constant (${unit})`);
  shown.cloud = cloudOf(part);
  const [wLow, wHigh] = extent([0, ...speed]), side = 0.06 * (wHigh - wLow);
  const tops = F.map((f, i) => f + (sd[i] ?? 0)), bottoms = F.map((f, i) => f - (sd[i] ?? 0));
  const ba = summary.friction.break_away, spread = summary.friction.break_away_sd ?? 0;
  const [low, high] = extent([...tops, ...bottoms, ...(level_known ? [0] : []), ...(ba === null ? [] : [ba - spread, ba + spread])]);
  friction.batch(() => { setRange(friction, "x", wLow - side, wHigh + side); setRange(friction, "y", low, high); friction.redraw(false); });
}

// ---- the cursor --------------------------------------------------------------------------------------------------

const dots = {};
for (const [name, plot] of Object.entries({ portrait, friction })) {
  dots[name] = plot.root.querySelector(".u-over").appendChild(document.createElement("div"));
  dots[name].className = "dot";
  dots[name].hidden = true;
}

let marked = []; // the samples at the two marks of a difference, at most

// The sample under the cursor of the trace; null where there is none.
function underCursor() {
  const { left } = trace.cursor, part = shown.rows;
  if (!(left >= 0 && part && part.last > part.first)) return null;
  const time = trace.posToVal(left, "x") + shown.origin, i = nearest(part, time);
  return isFar(trace, part.t[i] - time) || part.x[i] !== part.x[i] ? null : { t: part.t[i], x: part.x[i], v: part.v[i], a: part.a[i], text: "" };
}

function markDifference() {
  const sample = underCursor();
  if (sample) marked = [...(marked.length < 2 ? marked : []), sample];
  trace.redraw(false);
  showCursor();
}

// Between the two marks, or between the first and the cursor.
function difference(sample) {
  const [first, second = sample] = marked;
  if (!first || !second) return "";
  const [dt, dx] = [second.t - first.t, second.x - first.x];
  return `Δt ${onAxis(trace, "x", dt)} s, Δx ${onAxis(trace, "y", dx * scale.length)} ${scale.unit}, 1/Δt ${digits(1 / Math.abs(dt))} Hz`;
}

let held = null; // the time of a cursor that keys have moved

// No sample is shown for a cursor that is beside the record, or in a gap.
const isFar = (u, away) => !(Math.abs(away) < (u.scales.x.max - u.scales.x.min) / 50);

// The sample under the cursor in words and in the two other pictures, and the difference between the marks.
function showCursor() {
  const sample = underCursor();
  element("difference").textContent = difference(sample);
  if (!sample) {
    element("trace-at").textContent = "";
    for (const name in dots) dots[name].hidden = true;
    return;
  }
  const { t, x, v, a } = sample;
  let words = `t ${onAxis(trace, "x", t - shown.origin)} s, x ${onAxis(trace, "y", x * scale.length)} ${scale.unit}, v ${onAxis(trace, "w", v)} ${scale.speed}`;
  put("portrait", portrait, x * scale.length, v);
  if (hasFriction()) {
    words += `, relative speed ${onAxis(friction, "x", relativeSpeed(v))} ${scale.speed}, F ${onAxis(friction, "y", force(x, v, a))}${summary.balance.mass === null ? "" : " N"}`;
    put("friction", friction, relativeSpeed(v), force(x, v, a));
  }
  element("trace-at").textContent = words;
}

function put(name, plot, x, y) {
  const dot = dots[name], [left, top] = [plot.valToPos(x, "x"), plot.valToPos(y, "y")];
  const { width, height } = plot.bbox;
  dot.hidden = !(left >= 0 && top >= 0 && left <= width / devicePixelRatio && top <= height / devicePixelRatio);
  dot.style.left = `${left}px`; dot.style.top = `${top}px`;
}
