"use strict";
// The samples of the record: those that the server sends while it runs, and stretches of it that are asked for.

const KEEP_S = 120;
const element = (id) => document.getElementById(id);
const samples = { t: [], x: [], v: [], a: [], exact: true }; // the last KEEP_S; NaN where not known
const COLUMNS = ["t", "x", "v", "a"];
const markers = [];
let dropped = 0; // samples before these
let facts = null, latest = null, summary = null, ended = "";
let breakAways = []; // [time, position, time of the landing]

function cut(limit) {
  let first = 0;
  while (first < samples.t.length && samples.t[first] < limit) first++;
  if (first <= samples.t.length / 4) return;
  for (const name of COLUMNS) samples[name].splice(0, first);
  dropped += first;
}

function take(message, from, to) {
  for (const name of COLUMNS) for (let i = from; i < to; i++) samples[name].push(message[name][i] ?? NaN);
  if (samples.t.length) cut(samples.t[samples.t.length - 1] - KEEP_S);
}

const firstTime = () => facts && facts.finished ? facts.first : 0;
const lastTime = () => facts && facts.finished ? facts.last : samples.t.length ? samples.t[samples.t.length - 1] : 0;

// The first row that is not before a time: rows are in order.
function place(t, time) {
  let low = 0, high = t.length;
  while (low < high) { const middle = (low + high) >> 1; if (t[middle] < time) low = middle + 1; else high = middle; }
  return low;
}

// The row of a stretch that is nearest to a time.
function nearest(part, time) {
  const i = Math.min(part.last - 1, Math.max(part.first, place(part.t, time)));
  return i > part.first && time - part.t[i - 1] < part.t[i] - time ? i - 1 : i;
}

// A stretch of rows: arrays, and their first and last row within the asked times.  A row without a position separates.
function within(rows, from, to, base = 0) {
  const first = Math.max(0, place(rows.t, from) - 1), last = Math.min(rows.t.length, place(rows.t, to) + 1);
  return { ...rows, first, last, base };
}

let past = null; // the stretch that the server gave last: { t, x, v, a, from, to, exact }
let whole = null; // all of the record, thinned
let asking = null, notGiven = "";

const MOST_ROWS = 30000; // that the server gives sample by sample

function covers(stretch, from, to) {
  if (!stretch || stretch.from > from || stretch.to < to) return false;
  return stretch.exact || to - from > (stretch.to - stretch.from) / 2;
}

// Rows between two times, asked of the server where they are not here; what there is until they come.
function rows(from, to) {
  const begin = samples.t[0], end = lastTime();
  from = Math.max(from, firstTime()); to = Math.min(to, end);
  if (samples.t.length && (from >= begin || begin <= firstTime() + 1)) return within(samples, from, to, dropped);
  if (!covers(past, from, to) && !asking) ask(from, to);
  if (covers(past, from, to)) return within(past, from, to);
  if (whole && whole.from <= from) return within(whole, from, to);
  if (past && past.from < to && past.to > from) return within(past, from, to);
  return within(samples, from, to, dropped);
}

async function fetched(from, to) {
  const answer = await fetch(`stretch?from=${from}&to=${to}`);
  if (!answer.ok) throw new Error(await answer.text());
  const stretch = await answer.json();
  for (const name of "xva") stretch[name] = stretch[name].map((value) => value ?? NaN);
  return { ...stretch, from, to };
}

async function ask(from, to) {
  if (ended && !facts.finished && notGiven) return; // the server has gone with the recording
  const span = to - from, margin = 3 * span * facts.rate <= MOST_ROWS ? span : 0;
  asking = [from, to];
  try {
    past = await fetched(Math.max(firstTime(), from - margin), Math.min(lastTime(), to + margin));
    notGiven = "";
  } catch {
    notGiven = ended ? `The recording has ended. Show all of it with daq watch ${facts.file}` : "Older samples are not available: the viewer does not respond.";
  }
  asking = null;
  redraw();
}

// Before the server goes with the recording, all of it is asked for once.
async function askForAll() {
  try { whole = await fetched(firstTime(), lastTime()); } catch { /* it went sooner: the last two minutes stay */ }
}
