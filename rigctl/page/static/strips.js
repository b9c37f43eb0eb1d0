// Strip charts: one uPlot each, one path each, all on the same time axis.
import { Store } from "./store.js";
import { colours, keep, kept, nice, sized } from "./look.js";

const AXIS_PX = 66;
const SHORTEST_S = 2; // the closest zoom
const COMPENSATING = 3, CLOSED = [2, 3, 4]; // rigctl.model.states.Mode: where the error, the tension is regulated
const GUTTER_PX = 78; // right of the traces: what the lines are
const HAIR_PX = 0.7;
const POINTS = 2 * Store.BUCKETS;

export class Strips {
  constructor(root, store) {
    this.root = root;
    this.store = store;
    this.settings = null;
    this.draws = 0;
    this.end = this.span = null; // time in s at the right edge, and the span, where not those of the newest data
    this.cursorAt = null;
    this.events = [];
    this.marks = JSON.parse(kept("marks") ?? "[]");
    this.modes = new Array(POINTS).fill(null);
    this.onView = () => {};
    this.x = new Array(POINTS).fill(0);
    this.target = new Array(POINTS).fill(null);
    this.charts = [];
    this.lane = this.makeLane();
    new ResizeObserver(() => this.resize()).observe(root);
  }

  // What each strip shows, from the catalogue of signals; `least`: smallest span of its axis.
  set shown(strips) {
    for (const chart of this.charts) {
      chart.u?.destroy();
      chart.box.remove();
    }
    this.charts = strips.map((strip) => this.make(strip));
    this.restyle();
  }

  make(strip) {
    const box = document.createElement("div");
    box.className = "strip";
    const title = document.createElement("div");
    title.className = "title";
    title.append(`${strip.title} `);
    const value = title.appendChild(document.createElement("b"));
    const note = title.appendChild(document.createElement("span"));
    const plot = document.createElement("div");
    plot.className = "plot";
    box.append(title, plot);
    this.root.insertBefore(box, this.lane.parentElement);
    return { strip, box, plot, value, note, y: new Array(POINTS).fill(null), u: null, range: [0, 1] };
  }

  // Below the charts: the time of day, and what each marker is called.
  makeLane() {
    const lane = document.createElement("div");
    lane.className = "lane";
    const canvas = lane.appendChild(document.createElement("canvas"));
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", "time of day, and names of the events");
    this.root.append(lane);
    return canvas;
  }

  // (Re)made for a theme: uPlot takes its colours once.
  restyle() {
    const c = (this.c = colours());
    for (const chart of this.charts) {
      chart.u?.destroy();
      const grid = { stroke: c.grid, width: 1 }, ticks = { show: false };
      const axis = { stroke: c.dim, grid, ticks, font: "12px DejaVu Sans, sans-serif" };
      const sides = [
        { ...axis, size: 0, space: 90, values: (u, splits) => splits.map(() => "") },
        { ...axis, labelSize: 15, labelFont: axis.font, labelGap: 0, label: chart.strip.unit, size: AXIS_PX - 15, splits: () => ticksOf(chart.range, chart.plot.clientHeight) },
      ];
      const scales = { x: { time: true, auto: false }, y: { auto: false, range: () => chart.range } };
      chart.u = new uPlot({
        width: chart.plot.clientWidth || 300, height: chart.plot.clientHeight || 100, pxAlign: 0,
        legend: { show: false }, select: { show: true },
        cursor: { show: true, x: true, y: false, points: { show: false }, drag: { x: true, y: false, setScale: false }, sync: { key: "rigctl" } },
        scales, axes: sides,
        series: [{}, { stroke: c.trace, width: 1.5, points: { show: false }, spanGaps: false }],
        hooks: { drawClear: [(u) => this.under(u, chart, c)], draw: [(u) => this.over(u, chart, c)], setCursor: [(u) => this.pointed(u)], setSelect: [(u) => this.chosen(u)] },
        padding: [7, GUTTER_PX, 7, 0],
      }, [this.x, chart.y], chart.plot);
    }
  }

  newtonsFor(fallback) {
    return this.targetNow > 0 ? this.targetNow : fallback;
  }

  resize() {
    for (const chart of this.charts) chart.u?.setSize({ width: chart.plot.clientWidth, height: chart.plot.clientHeight });
  }

  draw(newest, windowS, names) {
    const store = this.store, edge = this.end ?? newest, spanS = this.span ?? windowS;
    this.newest = newest;
    this.windowS = windowS;
    this.settled = this.paused;
    store.points(names.indexOf("mode"), this.modes, 0);
    store.times(this.x);
    store.points(names.indexOf("target_n"), this.target, 0);
    this.targetNow = this.target.findLast((value) => value !== null) ?? 0;
    for (const chart of this.charts) {
      const signal = names.indexOf(chart.strip.signal);
      chart.range = this.rangeOf(chart, store.extremes(signal, edge - spanS, edge));
      store.points(signal, chart.y, (HAIR_PX * (chart.range[1] - chart.range[0])) / Math.max(chart.plot.clientHeight, 50));
      chart.u.batch(() => {
        chart.u.setData([this.x, chart.y], false);
        chart.u.setScale("x", { min: edge - spanS, max: edge });
        chart.u.setScale("y", { min: chart.range[0], max: chart.range[1] });
      });
    }
    this.names(edge - spanS, edge);
    this.draws++;
    if (this.paused) this.atCursor();
  }

  get paused() {
    return this.end !== null;
  }

  // The buckets to ask the server for: the narrowest that reach back to the left edge.
  levelFor(windowsS, chosen, newest) {
    if (!this.paused) return chosen;
    const needed = newest - this.end + (this.span ?? windowsS[chosen]);
    const found = windowsS.findIndex((seconds, i) => seconds >= needed && (i >= chosen || this.span !== null));
    return found < 0 ? windowsS.length - 1 : found;
  }

  follow() {
    this.look(null, null);
  }

  look(end, span) {
    this.end = end === null || end >= this.newest ? (span === null || end === null ? null : this.newest) : end;
    this.span = this.end === null ? null : span;
    this.settled = false;
    const pause = document.getElementById("pause");
    pause.setAttribute("aria-pressed", String(this.paused));
    pause.textContent = this.paused ? "go on" : "pause";
    this.onView();
  }

  // Buttons and keys beside the mouse.
  tools() {
    const on = (id, act) => document.getElementById(id).addEventListener("click", act);
    const span = () => this.span ?? this.windowS, end = () => this.end ?? this.newest;
    on("pause", () => (this.paused ? this.follow() : this.look(this.newest - 1e-3, this.windowS)));
    on("back", () => this.look(end() - 0.5 * span(), span()));
    on("forward", () => (end() + 0.5 * span() >= this.newest ? this.follow() : this.look(end() + 0.5 * span(), span())));
    on("closer", () => this.look(Math.min(end() - 0.25 * span() * (this.paused ? 1 : 0), this.newest - 1e-3), Math.max(SHORTEST_S, 0.5 * span())));
    on("wider", () => this.look(Math.min(end() + 0.5 * span(), this.newest - 1e-3), Math.min(3600, 2 * span())));
    on("marker", () => {
      this.marks = [...this.marks, Math.round(1000 * (this.cursorAt ?? this.newest)) / 1000].slice(-9);
      keep("marks", JSON.stringify(this.marks));
      this.settled = false;
      this.onView();
    });
    this.root.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key], u = this.charts[0]?.u;
      if (event.key === "Escape") this.follow();
      if (!step || !u) return;
      event.preventDefault();
      const left = (u.cursor.left >= 0 ? u.cursor.left : u.over.clientWidth) + step * (event.shiftKey ? 40 : 4);
      u.setCursor({ left: Math.min(Math.max(left, 0), u.over.clientWidth), top: 10 });
    });
  }

  pointed(u) {
    this.cursorAt = u.cursor.left >= 0 && u.cursor.idx != null ? u.posToVal(u.cursor.left, "x") : null;
    this.atCursor();
  }

  chosen(u) {
    if (u.select.width < 5) return;
    const from = u.posToVal(u.select.left, "x"), to = u.posToVal(u.select.left + u.select.width, "x");
    for (const chart of this.charts) chart.u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    this.look(Math.min(to, this.newest - 1e-3), Math.max(SHORTEST_S, to - from));
  }

  // The values under the cursor, and the event nearest to it.
  atCursor() {
    const at = this.cursorAt, said = document.getElementById("cursor");
    if (at === null) {
      if (said.textContent) said.textContent = "";
      return;
    }
    // Of the points as drawn: while paused the store may have gone on to wider buckets.
    const half = this.x[1] - this.x[0], i = Math.round((at - this.x[0]) / half);
    const parts = this.charts.map(({ strip, y }) => {
      const found = [y[i - 1], y[i], y[i + 1]].filter((value) => typeof value === "number");
      return found.length ? `${strip.title} ${(found.reduce((a, b) => a + b) / found.length).toFixed(strip.digits)} ${strip.unit}` : "";
    });
    const near = this.events.find((event) => Math.abs(event.wall_ms / 1000 - at) < Math.max(2 * half, (this.span ?? this.windowS) / 150));
    said.textContent = [clock(at), ...parts.filter(Boolean), near?.text ?? ""].filter(Boolean).join(" · ");
  }

  rangeOf(chart, found) {
    let [low, high] = found ?? [0, 0];
    if (chart.strip.signal === "vertical_n" && this.targetNow > 0 && high > 0.5 * this.targetNow) {
      const band = ((this.settings?.band_pct ?? 5) / 100) * this.targetNow; // the band is in sight from half-way up
      low = Math.min(low, this.targetNow - 1.2 * band);
      high = Math.max(high, this.targetNow + 1.2 * band);
    }
    const span = Math.max(high - low, chart.strip.least);
    const middle = (low + high) / 2, step = nice(span / 4);
    low = Math.min(low, middle - span / 2) - 0.04 * span;
    high = Math.max(high, middle + span / 2) + 0.04 * span;
    return [Math.floor(low / step) * step, Math.ceil(high / step) * step];
  }

  // Bands and limits, under the trace.
  under(u, chart, c) {
    const { ctx } = u, { left, top, width, height } = u.bbox;
    ctx.save();
    ctx.beginPath();
    ctx.rect(left, top, width, height);
    ctx.clip();
    const said = [];
    if (chart.strip.signal === "vertical_n") this.targetBands(u, c, said);
    if (chart.strip.signal === "error_pct" && this.settings) this.errorBands(u, c, said);
    for (const limit of this.settings?.[chart.strip.signal === "vertical_n" ? "tension_n" : chart.strip.signal] ?? []) {
      line(u, limit.value, c.limit);
      said.push([limit.value, `limit ${trimmed(limit.value)}`]);
    }
    this.moments(u, chart, c);
    ctx.restore();
    label(u, said, c.dim);
  }

  // The time of day, and under it the names of what the markers mark; of names that would overlap, the first.
  names(min, max) {
    const area = sized(this.lane), u = this.charts[0]?.u;
    if (!area || !u) return;
    const { ctx, width } = area, left = AXIS_PX, right = width - GUTTER_PX, c = this.c;
    const x = (at) => left + ((at - min) / (max - min)) * (right - left);
    ctx.font = "12px DejaVu Sans, sans-serif";
    ctx.fillStyle = c.dim;
    const step = stepOf((max - min) / Math.max(2, Math.floor((right - left) / 95)));
    ctx.textAlign = "center";
    for (let at = Math.ceil(min / step) * step; at <= max; at += step) {
      if (x(at) > left + 28 && x(at) < right - 28) ctx.fillText(clock(at), x(at), 11);
    }
    ctx.textAlign = "left";
    ctx.fillText("time", 6, 11);
    ctx.fillText("events", 6, 28);
    let last = left - 6;
    const named = [...this.events.map((event) => [event.wall_ms / 1000, event.name ?? "", event.severity === "error" ? c.bad : c.dim]), ...this.marks.map((at, i) => [at, `M${i + 1}`, c.ink])].sort((a, b) => a[0] - b[0]);
    for (const [at, name, colour] of named) {
      const from = x(at);
      if (at < min || at > max || from < last + 6 || from + ctx.measureText(name).width > width) continue;
      ctx.fillStyle = colour;
      ctx.fillText(name, from, 28);
      last = from + ctx.measureText(name).width;
    }
  }

  // Events on the time axis, and the reader's own markers.
  moments(u, chart, c) {
    const { ctx } = u, { left, top, width, height } = u.bbox, { min, max } = u.scales.x;
    let last = -Infinity;
    for (const event of this.events) {
      const at = event.wall_ms / 1000, x = u.valToPos(at, "x", true);
      if (at < min || at > max || x - last < 12) continue; // of events at the same place, the first
      last = x;
      ctx.strokeStyle = ctx.fillStyle = event.severity === "error" ? c.bad : event.severity === "warning" ? c.warn : c.dim;
      ctx.lineWidth = 1;
      ctx.globalAlpha = 0.55;
      ctx.beginPath();
      ctx.moveTo(x, top);
      ctx.lineTo(x, top + height);
      ctx.stroke();
      ctx.globalAlpha = 1;
    }
    ctx.fillStyle = ctx.strokeStyle = c.ink;
    this.marks.forEach((at) => {
      if (at < min || at > max) return;
      const x = u.valToPos(at, "x", true);
      ctx.setLineDash([2, 4]);
      ctx.beginPath();
      ctx.moveTo(x, top);
      ctx.lineTo(x, top + height);
      ctx.stroke();
      ctx.setLineDash([]);
    });
  }

  // Where nothing is regulated, error and tension are grey.
  over(u, chart, c) {
    const { signal } = chart.strip, { ctx } = u, { left, top, width, height } = u.bbox;
    if (signal !== "vertical_n" && signal !== "error_pct") return;
    const idle = (mode) => typeof mode === "number" && (signal === "error_pct" ? mode !== COMPENSATING : !CLOSED.includes(mode));
    ctx.save();
    ctx.beginPath();
    ctx.rect(left, top, width, height);
    ctx.clip();
    ctx.fillStyle = c.idle;
    for (let i = 0; i < POINTS; ) {
      let j = i + 2;
      if (idle(this.modes[i])) {
        while (j < POINTS && idle(this.modes[j])) j += 2;
        const from = u.valToPos(this.x[i], "x", true), to = u.valToPos(j < POINTS ? this.x[j] : this.x[POINTS - 1] + 1, "x", true);
        ctx.fillRect(from, top, to - from, height);
      }
      i = j;
    }
    ctx.restore();
  }

  targetBands(u, c, said) {
    const now = this.targetNow;
    if (now > 0) said.push([now, `target ${trimmed(now)}`]);
    const share = (this.settings?.band_pct ?? 5) / 100, own = this.ownNewtons();
    for (let i = 0; i < POINTS; ) {
      const target = this.target[i];
      let j = i;
      while (j < POINTS && this.target[j] === target) j++;
      if (target > 0) {
        const from = u.valToPos(this.x[i], "x", true), to = u.valToPos(this.x[Math.min(j, POINTS - 1)], "x", true);
        band(u, from, to, target * (1 - share), target * (1 + share), c.band);
        if (own) band(u, from, to, target - own, target + own, c.own);
        u.ctx.fillStyle = c.mark;
        u.ctx.fillRect(from, u.valToPos(target, "y", true) - 0.5, to - from, 1);
      }
      i = j;
    }
  }

  errorBands(u, c, said) {
    const { left, width } = u.bbox, pct = this.settings.band_pct;
    band(u, left, left + width, -pct, pct, c.band);
    said.push([pct, `band +${pct} %`], [-pct, `band −${pct} %`]);
    for (const limit of this.settings.error_n) {
      const share = (100 * limit.value) / this.newtonsFor(300);
      for (const side of [-share, share]) line(u, side, c.limit);
      said.push([share, `limit ${trimmed(limit.value)} N`]);
    }
    line(u, 0, c.mark);
  }

  // The rig's own narrowest limit of the vertical error, in N.
  ownNewtons() {
    return Math.min(...(this.settings?.error_n ?? []).map((limit) => limit.value), Infinity) || 0;
  }

  title(values, compensating, doubts, mode) {
    const error = !compensating ? null : (100 * values.error_n) / values.target_n;
    for (const { strip, value, note } of this.charts) {
      const number = strip.signal === "error_pct" ? error : values[strip.signal];
      const doubt = doubts[strip.device];
      value.textContent = doubt !== undefined ? `- (${doubt})` : typeof number === "number" ? `${number.toFixed(strip.digits)} ${strip.unit}` : "-";
      if (strip.signal === "vertical_n") note.textContent = `  target ${trimmed(values.target_n)} N, band ±${this.settings?.band_pct ?? 5} %`;
      if (strip.signal === "error_pct") note.textContent = doubt !== undefined ? "" : compensating ? `  ${signed(values.error_n, 3)} N` : mode === "TENSIONING" ? "  (on the way to the target)" : "  (nothing is regulated)";
    }
  }
}

const clock = (seconds) => new Date(1000 * seconds).toLocaleTimeString([], { hour12: false });
const trimmed = (value) => (typeof value === "number" ? String(Number(value.toPrecision(4))) : "-");
const signed = (value, digits) => (typeof value === "number" ? (value < 0 ? "" : "+") + value.toFixed(digits) : "-");

// Three ticks at least: multiples of a round step, else both ends and the middle.
function ticksOf([low, high], heightPx) {
  const most = Math.max(2, Math.floor((heightPx - 14) / 17)), step = nice((high - low) / most), found = [];
  for (let at = Math.ceil(low / step - 1e-9) * step; at <= high + 1e-9 * step; at += step) found.push(Math.abs(at) < 1e-9 * step ? 0 : at);
  return found.length >= 3 ? found : [low, (low + high) / 2, high];
}

// A round step of time in s.
function stepOf(least) {
  return [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800].find((step) => step >= least) ?? 3600;
}

// What the lines are, right of the traces; of two that would overlap, the first.
function label(u, said, colour) {
  const { ctx } = u, { left, top, width, height } = u.bbox, drawn = [];
  ctx.save();
  ctx.fillStyle = colour;
  ctx.font = `${11 * devicePixelRatio}px DejaVu Sans, sans-serif`;
  ctx.textAlign = "left";
  ctx.textBaseline = "middle";
  for (const [value, text] of said) {
    const y = u.valToPos(value, "y", true);
    if (y < top - 1 || y > top + height + 1 || drawn.some((other) => Math.abs(other - y) < 12 * devicePixelRatio)) continue;
    drawn.push(y);
    ctx.fillText(text, left + width + 4 * devicePixelRatio, y);
  }
  ctx.restore();
}

function band(u, from, to, low, high, colour) {
  const top = u.valToPos(high, "y", true), bottom = u.valToPos(low, "y", true);
  u.ctx.fillStyle = colour;
  u.ctx.fillRect(from, Math.max(top, u.bbox.top), to - from, Math.min(bottom, u.bbox.top + u.bbox.height) - Math.max(top, u.bbox.top));
}

function line(u, value, colour) {
  const { ctx } = u, y = u.valToPos(value, "y", true), { left, top, width, height } = u.bbox;
  if (y < top || y > top + height) return;
  ctx.strokeStyle = colour;
  ctx.lineWidth = 1;
  ctx.setLineDash([6, 5]);
  ctx.beginPath();
  ctx.moveTo(left, y);
  ctx.lineTo(left + width, y);
  ctx.stroke();
  ctx.setLineDash([]);
}
