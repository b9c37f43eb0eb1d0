// Lateness of every tick in the window, both axes logarithmic, with the period and the deadlines missed.
import { colours, sized } from "./look.js";

const MARGIN = { left: 48, right: 10, top: 6, bottom: 22 };
const LABELS = [[1, "1 µs"], [10, "10"], [100, "100"], [1000, "1 ms"], [10000, "10"], [100000, "100"]];

export class Histogram {
  constructor(canvas, label) {
    this.canvas = canvas;
    this.label = label;
    this.edges = [];
    this.periodUs = null;
    this.found = null;
    this.restyle();
  }

  restyle() {
    this.c = colours();
    this.draw();
  }

  take(found) {
    this.found = found;
    this.draw();
  }

  draw() {
    const area = sized(this.canvas), found = this.found;
    if (!area || !found || !this.edges.length) return;
    const { ctx, width, height } = area, c = this.c, right = width - MARGIN.right, bottom = height - MARGIN.bottom;
    const [least, most] = [Math.log10(this.edges[0]), Math.log10(this.edges.at(-1))];
    const decades = Math.max(1, Math.ceil(Math.log10(Math.max(...found.counts, 1) + 1)));
    const x = (us) => MARGIN.left + ((Math.log10(us) - least) / (most - least)) * (right - MARGIN.left);
    const y = (count) => bottom - ((Math.log10(count) + 0.3) / (decades + 0.3)) * (bottom - MARGIN.top);
    this.label.replaceChildren(`${brief(found.ticks)} ticks, worst ${duration(found.worst_us)}, `, missed(found.missed));
    ctx.font = "12px DejaVu Sans, sans-serif";
    ctx.lineWidth = 1;
    ctx.strokeStyle = c.grid;
    ctx.fillStyle = c.dim;
    ctx.textAlign = "right";
    for (let decade = 0; decade <= decades; decade++) {
      const at = y(10 ** decade);
      rule(ctx, MARGIN.left, at, right, at);
      ctx.fillText(short(10 ** decade), MARGIN.left - 6, at + 4);
    }
    ctx.textAlign = "center";
    for (const [us, text] of LABELS) ctx.fillText(text, Math.min(x(us), right - 12), bottom + 16);
    for (let i = 0; i < found.counts.length; i++) {
      if (!found.counts[i]) continue;
      const from = x(this.edges[i]), top = y(found.counts[i]);
      ctx.fillStyle = this.periodUs && this.edges[i] >= this.periodUs ? c.bad : c.trace;
      ctx.fillRect(from, top, Math.max(1, x(this.edges[i + 1]) - from - 1), bottom - top);
    }
    if (this.periodUs) {
      ctx.strokeStyle = c.bad;
      ctx.setLineDash([6, 5]);
      rule(ctx, x(this.periodUs), MARGIN.top, x(this.periodUs), bottom);
      ctx.setLineDash([]);
      ctx.fillStyle = c.bad;
      ctx.textAlign = "left";
      ctx.fillText("period", x(this.periodUs) + 4, MARGIN.top + 12);
    }
  }
}

function missed(count) {
  const text = document.createElement("b");
  text.className = count ? "red" : "";
  text.textContent = `${count} missed`;
  return text;
}

function rule(ctx, x0, y0, x1, y1) {
  ctx.beginPath();
  ctx.moveTo(x0, y0);
  ctx.lineTo(x1, y1);
  ctx.stroke();
}

const brief = (count) => (count >= 1e6 ? `${(count / 1e6).toFixed(1)}M` : count >= 1e4 ? `${Math.round(count / 1e3)}k` : String(count));
const duration = (us) => (us < 1000 ? `${us.toFixed(0)} µs` : `${(us / 1000).toPrecision(3)} ms`);
const short = (count) => (count >= 1e6 ? `${count / 1e6}M` : count >= 1e3 ? `${count / 1e3}k` : String(count));
