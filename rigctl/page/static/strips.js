// Strip charts: one uPlot each, one path each, all on the same time axis.
import { Store } from "./store.js";
import { colours, nice } from "./look.js";

const AXIS_PX = 60;
const HAIR_PX = 0.7;
const POINTS = 2 * Store.BUCKETS;

// What each strip shows; `least`: smallest span of its axis.
const STRIPS = [
  { signal: "vertical_n", title: "tension, vertical", unit: "N", digits: 2, least: 2 },
  { signal: "error_pct", title: "vertical error", unit: "%", digits: 3, least: 0.02, newtons: true },
  { signal: "stroke_mm", title: "stroke", unit: "mm", digits: 2, least: 0.5 },
  { signal: "speed_mm_s", title: "speed", unit: "mm/s", digits: 2, least: 0.5 },
];

export class Strips {
  constructor(root, store) {
    this.root = root;
    this.store = store;
    this.settings = null;
    this.draws = 0;
    this.x = new Array(POINTS).fill(0);
    this.target = new Array(POINTS).fill(null);
    this.charts = STRIPS.map((strip, i) => this.make(strip, i === STRIPS.length - 1));
    new ResizeObserver(() => this.resize()).observe(root);
  }

  make(strip, last) {
    const box = document.createElement("div");
    box.className = last ? "strip last" : "strip";
    const title = document.createElement("div");
    title.className = "title";
    title.append(`${strip.title} `);
    const value = title.appendChild(document.createElement("b"));
    const note = title.appendChild(document.createElement("span"));
    const plot = document.createElement("div");
    plot.className = "plot";
    box.append(title, plot);
    this.root.append(box);
    return { strip, last, box, plot, value, note, y: new Array(POINTS).fill(null), u: null, range: [0, 1] };
  }

  // (Re)made for a theme: uPlot takes its colours once.
  restyle() {
    const c = colours();
    for (const chart of this.charts) {
      chart.u?.destroy();
      const grid = { stroke: c.grid, width: 1 }, ticks = { show: false };
      const axis = { stroke: c.dim, grid, ticks, font: "12px DejaVu Sans, sans-serif" };
      const sides = [
        { ...axis, show: true, size: chart.last ? 24 : 0, space: 90,
          values: (u, splits) => splits.map((at) => (chart.last ? clock(at) : "")) },
        { ...axis, size: AXIS_PX, space: 26 },
      ];
      const scales = { x: { time: true, auto: false }, y: { auto: false, range: () => chart.range } };
      const rightSide = { ...axis, side: 1, scale: "newtons", size: AXIS_PX, space: 26, grid: { show: false },
        values: (u, splits) => splits.map((v) => (v === null ? "" : `${trimmed(v)} N`)) };
      if (chart.strip.newtons) {
        scales.newtons = { auto: false, range: (u, min, max) => [min, max] };
        sides.push(rightSide);
      } else {
        sides.push({ ...rightSide, scale: "y", values: (u, splits) => splits.map(() => "") });
      }
      chart.u = new uPlot({
        width: chart.plot.clientWidth || 300, height: chart.plot.clientHeight || 100, pxAlign: 0,
        legend: { show: false }, cursor: { show: false }, select: { show: false }, scales, axes: sides,
        series: [{}, { stroke: c.trace, width: 1.5, points: { show: false }, spanGaps: false }],
        hooks: { drawClear: [(u) => this.under(u, chart, c)] },
        padding: [6, 0, chart.last ? 0 : 4, 0],
      }, [this.x, chart.y], chart.plot);
    }
  }

  newtonsFor(fallback) {
    return this.targetNow > 0 ? this.targetNow : fallback;
  }

  resize() {
    for (const chart of this.charts) chart.u?.setSize({ width: chart.plot.clientWidth, height: chart.plot.clientHeight });
  }

  draw(now, windowS, names) {
    const store = this.store, edge = store.edge(now) / 1000;
    store.times(this.x);
    store.points(names.indexOf("target_n"), this.target, 0);
    this.targetNow = this.target.findLast((value) => value !== null) ?? 0;
    for (const chart of this.charts) {
      const signal = names.indexOf(chart.strip.signal);
      chart.range = this.rangeOf(chart, store.extremes(signal));
      store.points(signal, chart.y, (HAIR_PX * (chart.range[1] - chart.range[0])) / Math.max(chart.plot.clientHeight, 50));
      chart.u.batch(() => {
        chart.u.setData([this.x, chart.y], false);
        chart.u.setScale("x", { min: edge - windowS, max: edge });
        chart.u.setScale("y", { min: chart.range[0], max: chart.range[1] });
        if (chart.strip.newtons) {
          const [min, max] = chart.range.map((pct) => (pct * this.newtonsFor(100)) / 100);
          chart.u.setScale("newtons", { min, max });
        }
      });
    }
    this.draws++;
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
    if (chart.strip.signal === "vertical_n") this.targetBands(u, c);
    if (chart.strip.signal === "error_pct" && this.settings) this.errorBands(u, c);
    for (const limit of this.settings?.[chart.strip.signal === "vertical_n" ? "tension_n" : chart.strip.signal] ?? []) {
      line(u, limit.value, limit.action === "log" ? c.warn : c.bad);
    }
    ctx.restore();
  }

  targetBands(u, c) {
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

  errorBands(u, c) {
    const { left, width } = u.bbox, pct = this.settings.band_pct;
    band(u, left, left + width, -pct, pct, c.band);
    for (const limit of this.settings.error_n) {
      const share = (100 * limit.value) / this.newtonsFor(300);
      for (const side of [-share, share]) line(u, side, limit.action === "log" ? c.warn : c.bad);
    }
    line(u, 0, c.mark);
  }

  // The rig's own narrowest limit of the vertical error, in N.
  ownNewtons() {
    return Math.min(...(this.settings?.error_n ?? []).map((limit) => limit.value), Infinity) || 0;
  }

  title(values, compensating) {
    const byName = { vertical_n: values.vertical_n, error_pct: values.error_n === null ? null : (100 * values.error_n) / values.target_n, stroke_mm: values.stroke_mm, speed_mm_s: values.speed_mm_s };
    for (const { strip, value, note } of this.charts) {
      const number = byName[strip.signal];
      value.textContent = typeof number === "number" ? `${number.toFixed(strip.digits)} ${strip.unit}` : "-";
      if (strip.signal === "vertical_n") note.textContent = `  target ${trimmed(values.target_n)} N, band ±${this.settings?.band_pct ?? 5} %`;
      if (strip.signal === "error_pct") note.textContent = compensating ? `  ${signed(values.error_n, 3)} N` : "  (not COMPENSATING)";
    }
  }
}

const clock = (seconds) => new Date(1000 * seconds).toLocaleTimeString([], { hour12: false });
const trimmed = (value) => (typeof value === "number" ? String(Number(value.toPrecision(4))) : "-");
const signed = (value, digits) => (typeof value === "number" ? (value < 0 ? "" : "+") + value.toFixed(digits) : "-");

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
