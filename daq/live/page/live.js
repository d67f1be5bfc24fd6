"use strict";
// The live view: what is shown, and what its controls do.

const FRAME_MS = 40, HALF_MS = 50; // between messages 100 ms pass: the second half of the samples is drawn so long after the first
const FRICTION_EVERY = 20; // frames
const EARLIER = 5; // break-aways under the last one
let waiting = null; // a message whose second half is not among the samples yet
let dirty = false, scheduled = false, frames = 0, drawn = 0;

// What is shown: the last seconds while a recording runs; from `from` to `to` when paused; or the break-away `at` of them.
const view = { paused: false, from: 0, to: 0, span: 5, at: -1 };
const following = () => !view.paused && !(facts && facts.finished);
const triggered = () => element("mode").value === "trigger";

function redraw() {
  dirty = true;
  if (!scheduled) { scheduled = true; requestAnimationFrame(tick); }
}

function tick(now) {
  scheduled = false;
  if (!dirty) return;
  if (now - drawn < FRAME_MS - 8) { scheduled = true; requestAnimationFrame(tick); return; }
  drawn = now; dirty = false;
  draw();
}

// ---- what comes --------------------------------------------------------------------------------------------------

const middle = (message) => Math.ceil(message.t.length / 2);

function takeRest() {
  if (!waiting) return;
  const message = waiting;
  waiting = null;
  take(message, middle(message), message.t.length);
  if (!view.paused) redraw();
}

function receive(event) {
  takeRest();
  const message = JSON.parse(event.data);
  if (message.marker) markers.push(message.marker);
  if (message.counts) latest = message;
  if (message.summary) setSummary(message);
  if (message.progress !== undefined && facts) {
    facts.progress = message.progress; past = null; // there is more of it now
    if (message.progress === 1) showResult();
  }
  if (message.t) {
    waiting = message;
    take(message, 0, middle(message));
    setTimeout(takeRest, HALF_MS);
  }
  if (message.ended) end(message);
  showState();
  if (!view.paused || message.marker || (facts && facts.finished)) { showFacts(); redraw(); } else showFacts();
}

function setSummary(message) {
  summary = message.summary;
  const known = breakAways.length ? breakAways[breakAways.length - 1][0] : -Infinity; // a page that connects is told of all at once
  for (const one of message.break_aways) if (one[0] > known) breakAways.push(one);
  showPanel();
}

function end(message) {
  ended = message.ended;
  if (message.duration) { facts.duration = message.duration; showResult(); }
  source.close();
  if (!facts || !facts.finished) askForAll();
  element("stop").disabled = element("mark").disabled = true;
  element("ending").close();
}

// Where the recording is, what it holds, and the command that comes next.
function showResult() {
  const { samples: n, segments, lost } = latest.counts, gaps = Math.max(0, segments - 1), many = (count, word) => `${count.toLocaleString("en")} ${word}${count === 1 ? "" : "s"}`;
  const holds = [many(n, "sample"), `${facts.duration.toFixed(1)} s`, gaps ? many(gaps, "gap") : "no gaps"];
  if (lost) holds.push(`${lost.toLocaleString("en")} lost`);
  const command = document.createElement("kbd");
  command.textContent = facts.next;
  element("result").replaceChildren(`${facts.path}: ${holds.join(", ")}.  Next: `, command);
  element("result").hidden = false;
}

function showState() {
  const open = source.readyState === EventSource.OPEN, gone = source.readyState === EventSource.CLOSED;
  let words = ended;
  if (!ended && !open) words = gone || lostFor() > 5 ? "no connection" : facts ? "reconnecting" : "connecting";
  else if (!ended) words = facts && facts.finished ? facts.progress < 1 ? `reading: ${Math.round(100 * facts.progress)} %` : "finished run" : latest ? latest.state : "waiting";
  const state = element("state");
  state.dataset.state = ended || (facts && facts.finished && open) ? "ended" : open && latest ? latest.state : open ? "waiting" : "lost";
  if (state.textContent !== words) state.textContent = words;
  let trouble = said.words || notGiven || (open && latest && latest.trouble) || "";
  if (!ended && (gone || (!open && lostFor() > 5))) {
    trouble = `The viewer does not respond. The recording continues without it. Open another view with daq watch ${facts ? facts.file : "RUN.h5"}`;
  }
  const line = element("trouble");
  line.hidden = !trouble;
  if (line.textContent !== trouble) line.textContent = trouble;
}

let lostAt = performance.now();
const lostFor = () => (performance.now() - lostAt) / 1000;
const said = { words: "", until: 0 };

function say(words) {
  said.words = words;
  clearTimeout(said.until);
  said.until = setTimeout(() => { said.words = ""; showState(); }, 8000);
  showState();
}

function setText(field, text) { if (field.textContent !== text) field.textContent = text; }
const set = (id, text) => setText(element(id), text);

function showFacts() {
  if (!latest) return;
  const now = lastTime();
  set("elapsed", `${now.toFixed(1)} s`);
  if (facts && facts.duration) {
    set("remaining", `${Math.max(0, facts.duration - now).toFixed(1)} s`);
    set("duration", `${facts.duration.toFixed(1)} s`);
  }
  for (const [name, number] of Object.entries(latest.counts)) {
    const field = element(name), wrong = number > 0 && !["samples", "segments"].includes(name);
    set(name, String(number));
    field.classList.toggle("wrong", wrong);
    if (field.parentElement.classList.contains("fault")) field.parentElement.hidden = !number;
  }
  showScroll();
}

const ROWS = [["stick_s", "stick", "s"], ["slip_s", "slip", "s"], ["drop", "drop", ""], ["break_away", "break-away", ""]];
const SOURCES = { encoder: "by its encoder", sticks: "mean of the last sticks", motion: "the velocity that occurs most often", calibration: "of the calibration" };

function statisticsRow(name) {
  const row = document.createElement("tr"), head = document.createElement("th");
  row.id = name; head.scope = "row";
  head.append(document.createElement("span"), " ", document.createElement("span")); // a line may end between the two alone
  row.append(head, ...Array.from({ length: 5 }, () => document.createElement("td")));
  return row;
}

function showPanel() {
  const { cycles, advice, belt, k_over_m, balance, statistics } = summary;
  drawUnit();
  set("cycles", `${cycles} cycle${cycles === 1 ? "" : "s"}`);
  element("cycles").dataset.enough = summary.enough;
  set("advice", advice);
  let words = belt.value === null ? "not known" : `${digits(belt.value)} ${scale.speed}, ${SOURCES[belt.source] || ""}`;
  if (belt.calibrated !== null && belt.source !== "calibration") words += ` (calibration ${digits(belt.calibrated)})`;
  set("belt", words);
  words = k_over_m.value === null ? "not known" : `${digits(k_over_m.value)} ± ${digits(k_over_m.stderr, 2)} s⁻², from the slips`;
  if (balance.k_over_m !== null && balance.k_over_m !== k_over_m.value) words += ` (calibration ${digits(balance.k_over_m)})`;
  set("k_over_m", words);
  element("x0").hidden = balance.level_known || !summary.friction;
  const body = element("statistics");
  if (!body.rows.length) for (const [name] of ROWS) body.appendChild(statisticsRow(name));
  for (const [name, title, unit] of ROWS) {
    const of = statistics[name], factor = unit ? 1 : scale.length, cells = element(name).cells;
    // Two digits of the standard deviation, and so many of the others.
    const size = factor * Math.abs(of.sd || of.mean / 100 || 1), decimals = Math.min(9, Math.max(0, 1 - Math.floor(Math.log10(size))));
    ["last", "mean", "sd", "min", "max"].forEach((key, i) => setText(cells[i + 1], of[key] === null ? "–" : (factor * of[key]).toFixed(decimals)));
    const [quantity, inUnit] = cells[0].children;
    setText(quantity, title);
    setText(inUnit, `(${unit || scale.unit})`);
  }
  element("break_away").cells[0].title = balance.level_known ? "stretch of the spring" : "position: x0 is not known";
}

function drawUnit() {
  const unit = latest ? latest.unit : facts ? facts.unit : "m";
  Object.assign(scale, unit === "m" ? { length: 1e3, unit: "mm", speed: "m/s" } : { length: 1, unit: "counts", speed: "counts/s" });
}

// ---- what is shown -----------------------------------------------------------------------------------------------

function draw() {
  if (!facts || (!samples.t.length && !facts.finished)) return;
  let { from, to } = view, origin = 0, earlier = [];
  if (triggered() && breakAways.length) {
    const at = shownBreakAway();
    origin = breakAways[at][0];
    const width = view.span || 5;
    from = origin - width / 4; to = origin + 3 * width / 4;
    let oldest = Math.max(0, at - EARLIER); // as many as the server gives at once
    while (oldest < at && (to - breakAways[oldest][0] + width / 4) * facts.rate > MOST_ROWS) oldest++;
    const all = rows(breakAways[oldest][0] - width / 4, to);
    for (let k = oldest; k < at && all.exact; k++) {
      const [own] = breakAways[k];
      earlier.push([within(all, own - width / 4, own + 3 * width / 4), own]);
    }
    element("trace-title").textContent = `position and velocity about break-away ${at + 1} of ${breakAways.length}, at ${origin.toFixed(3)} s` + (earlier.length ? ", over those before" : "");
  } else {
    if (following()) {
      to = lastTime(); from = view.span ? to - view.span : firstTime();
      from = Math.max(from, firstTime()); to = Math.max(to, from + Math.min(view.span || 1, 1));
      Object.assign(view, { from, to });
    }
    element("trace-title").textContent = triggered() ? "no break-away so far: position and velocity against time" : "position and velocity against time";
  }
  const part = rows(from, to);
  drawAll(part, from, to, origin, earlier, frames % FRICTION_EVERY === 0 || !following());
  frames++;
  document.body.dataset.frames = frames;
}

// The slider scrolls through the record, or from break-away to break-away.
function showScroll() {
  const scroll = element("scroll"), first = firstTime(), last = lastTime(), span = Math.min(view.to - view.from, last - first);
  const steps = triggered() && breakAways.length > 0, at = shownBreakAway();
  const [min, max, value] = steps ? [0, breakAways.length - 1, at] : [first, Math.max(first + 1e-3, last - span), following() ? last : view.from];
  Object.assign(scroll, { min, max, step: steps ? 1 : "any", disabled: steps ? max === 0 : span >= last - first });
  if (document.activeElement !== scroll || !view.paused || steps) scroll.value = value;
  const words = steps ? `break-away ${at + 1} of ${max + 1}` : `${digits(view.from)} to ${digits(view.to)} s of ${digits(last)} s`;
  if (!following()) scroll.setAttribute("aria-valuetext", words); else scroll.removeAttribute("aria-valuetext");
}

const shownBreakAway = () => view.at < 0 ? breakAways.length - 1 : Math.min(view.at, breakAways.length - 1);

function setPaused(paused) {
  if (facts && facts.finished) paused = true;
  view.paused = paused;
  element("pause").setAttribute("aria-pressed", paused);
  element("pause").textContent = paused ? "Resume" : "Pause";
  if (!paused) { view.at = -1; notGiven = ""; }
  redraw();
}

// Show a stretch, within the record; a running recording is paused first.
function show(from, to) {
  const first = firstTime(), last = lastTime(), least = 4 / facts.rate;
  let span = Math.min(Math.max(to - from, least), Math.max(last - first, least));
  if (from < first) from = first;
  if (from + span > last) from = Math.max(first, last - span);
  Object.assign(view, { from, to: from + span });
  if (!view.paused) setPaused(true);
  redraw(); showScroll();
}

function zoomTo(from, to) {
  if (triggered()) element("mode").value = "roll";
  show(from, to);
}

function zoom(factor, about = (view.from + view.to) / 2) {
  if (triggered()) { setSpan(Math.max(4 / facts.rate, (view.span || 5) * factor)); return; }
  const share = (about - view.from) / (view.to - view.from), span = (view.to - view.from) * factor;
  show(about - share * span, about + (1 - share) * span);
}

function setSpan(span) {
  view.span = span;
  const select = element("window"), known = [...select.options].some((option) => Number(option.value) === span);
  select.value = known ? String(span) : "";
}

function scrollBy(share) {
  if (triggered() && breakAways.length) {
    showBreakAway(shownBreakAway() + Math.sign(share));
    return;
  }
  const by = share * (view.to - view.from);
  show(view.from + by, view.to + by);
}

function showBreakAway(at) {
  const chosen = Math.max(0, Math.min(breakAways.length - 1, at));
  if (!view.paused) setPaused(true);
  view.at = chosen;
  redraw(); showScroll();
}

function resetZoom() {
  marked = [];
  const span = Number(element("window").value || 5), last = lastTime();
  setSpan(span);
  element("lock").checked = false;
  held = null;
  if (following()) { redraw(); return; }
  if (!span) { show(firstTime(), last); return; }
  const about = (view.from + view.to) / 2;
  show(about - span / 2, about + span / 2);
}

function moveCursor(steps) {
  const part = shown.rows;
  if (!part || part.last <= part.first) return;
  const { left } = trace.cursor, middle = (trace.scales.x.min + trace.scales.x.max) / 2 + shown.origin;
  const from = held ?? (left >= 0 ? trace.posToVal(left, "x") + shown.origin : middle);
  const i = Math.min(part.last - 1, Math.max(part.first, nearest(part, from) + steps));
  held = part.t[i];
  trace.setCursor({ left: trace.valToPos(held - shown.origin, "x"), top: trace.bbox.height / devicePixelRatio / 2 });
}

// ---- controls ----------------------------------------------------------------------------------------------------

async function post(path, body) {
  const answer = await fetch(path, { method: "POST", headers: { "Content-Type": "text/plain" }, body });
  if (!answer.ok) throw new Error(await answer.text());
}

async function mark(event) {
  if (event) event.preventDefault();
  const words = element("words");
  try { await post("marker", words.value || "marker"); words.value = ""; } catch (error) { say(`The marker was not stored: ${error.message}`); }
}

async function stop() {
  const button = element("stop");
  button.disabled = true;
  try {
    await post("stop", "stop");
    say("Stopping and saving.");
    setTimeout(() => { if (!ended) { button.disabled = false; say("The recording has not stopped. Press Ctrl-C in its terminal."); } }, 6000);
  } catch (error) { button.disabled = false; say(`The recording was not stopped: ${error.message}`); }
}

function save() {
  const plots = [trace, portrait, friction], gap = 16 * devicePixelRatio;
  const sheet = document.createElement("canvas");
  sheet.width = Math.max(...plots.map((plot) => plot.ctx.canvas.width));
  sheet.height = plots.reduce((sum, plot) => sum + plot.ctx.canvas.height + gap, 0);
  const ctx = sheet.getContext("2d");
  ctx.fillStyle = colours.paper; ctx.fillRect(0, 0, sheet.width, sheet.height);
  let at = 0;
  for (const plot of plots) { ctx.drawImage(plot.ctx.canvas, 0, at); at += plot.ctx.canvas.height + gap; }
  const link = document.createElement("a");
  link.download = (facts ? facts.file.replace(/\.h5$/, "") : "run") + "-live.png";
  link.href = sheet.toDataURL("image/png");
  link.click();
}

function setTheme() {
  const theme = element("theme").value;
  if (theme) document.documentElement.dataset.theme = theme; else delete document.documentElement.dataset.theme;
  readColours();
  for (const plot of [trace, portrait, friction]) plot.redraw(false);
  redraw();
}

const pause = () => setPaused(!view.paused);
element("pause").addEventListener("click", pause);
element("controls").addEventListener("submit", mark);
element("save").addEventListener("click", save);
element("back").addEventListener("click", () => scrollBy(-0.25));
element("forward").addEventListener("click", () => scrollBy(0.25));
element("in").addEventListener("click", () => zoom(0.5));
element("out").addEventListener("click", () => zoom(2));
element("reset").addEventListener("click", resetZoom);
element("theme").addEventListener("change", setTheme);
element("stop").addEventListener("click", () => element("ending").showModal());
element("ending").addEventListener("close", () => { if (element("ending").returnValue === "stop") stop(); element("ending").returnValue = ""; });
element("lock").addEventListener("change", redraw);
element("mode").addEventListener("change", () => { view.at = -1; redraw(); showScroll(); });
element("window").addEventListener("change", () => {
  setSpan(Number(element("window").value));
  if (view.paused || !view.span) resetZoom(); else redraw();
});
element("scroll").addEventListener("input", () => {
  const value = Number(element("scroll").value), span = view.to - view.from;
  if (triggered() && breakAways.length) showBreakAway(value); else show(value, value + span);
});
const over = trace.root.querySelector(".u-over");
over.addEventListener("wheel", (event) => {
  if (following()) return; // the page scrolls
  event.preventDefault();
  if (Math.abs(event.deltaX) > Math.abs(event.deltaY)) scrollBy(Math.sign(event.deltaX) * 0.1);
  else zoom(event.deltaY < 0 ? 0.8 : 1.25, trace.posToVal(event.offsetX, "x") + shown.origin);
}, { passive: false });
// A finger drags what is shown; a mouse selects what to zoom into.
let finger = null;
over.addEventListener("pointerdown", (event) => {
  if (event.pointerType !== "touch" || following() || triggered()) return;
  finger = { x: event.clientX, from: view.from, to: view.to };
  over.setPointerCapture(event.pointerId);
});
over.addEventListener("pointermove", (event) => {
  if (!finger) return;
  const by = (finger.x - event.clientX) / over.clientWidth * (finger.to - finger.from);
  show(finger.from + by, finger.to + by);
});
for (const type of ["pointerup", "pointercancel"]) over.addEventListener(type, () => { finger = null; });
over.addEventListener("mousemove", () => { held = null; });
let pressed = 0; // where the pointer went down: a drag is no click
over.addEventListener("pointerdown", (event) => { pressed = event.clientX; });
over.addEventListener("click", (event) => { if (Math.abs(event.clientX - pressed) < 4) markDifference(); });
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", setTheme);

const KEYS = {
  ArrowLeft: () => scrollBy(-0.25), ArrowRight: () => scrollBy(0.25), "+": () => zoom(0.5), "=": () => zoom(0.5), "-": () => zoom(2),
  Home: () => show(firstTime(), firstTime() + view.to - view.from), End: () => facts && facts.finished ? show(lastTime() - (view.to - view.from), lastTime()) : setPaused(false),
  Escape: resetZoom, ",": () => moveCursor(-1), ".": () => moveCursor(1), a: () => element("lock").click(), d: () => markDifference(), m: () => mark(), s: save,
  t: () => { element("mode").value = triggered() ? "roll" : "trigger"; element("mode").dispatchEvent(new Event("change")); },
};
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || element("ending").open) return;
  if (event.target.matches("input[type=text], select")) return;
  if (event.target.matches("input[type=range]") && event.key !== "Escape" && event.key !== " ") return;
  if (event.key === " ") {
    if (event.target.matches("button, input[type=checkbox]")) return;
    event.preventDefault();
    pause();
  } else if (KEYS[event.key] && facts) { event.preventDefault(); KEYS[event.key](); }
});

const source = new EventSource("events");
source.addEventListener("facts", (event) => {
  const first = !facts;
  facts = JSON.parse(event.data);
  facts.progress = facts.finished ? 0 : 1;
  document.body.dataset.kind = facts.finished ? "finished" : "running";
  document.title = `${facts.file}: ${facts.finished ? "run" : "live"}`;
  set("title", `${facts.file}: ${facts.title}`);
  set("rate", `${facts.rate} Hz` + (facts.every > 1 ? `, every ${facts.every}th drawn` : ""));
  breakAways = [];
  setSummary(facts);
  if (facts.finished) {
    markers.splice(0, markers.length, ...facts.markers);
    set("started", facts.started.replace("T", " ").slice(0, 19));
    document.querySelector(".counted").hidden = !facts.counted;
    if (first) { setPaused(true); element("window").value = "0"; setSpan(0); show(facts.first, facts.last); }
  }
});
source.addEventListener("message", receive);
source.addEventListener("open", () => { lostAt = Infinity; showState(); });
source.addEventListener("error", () => { if (lostAt === Infinity) lostAt = performance.now(); showState(); });
document.body.dataset.kind = "waiting";
setInterval(showState, 1000);
