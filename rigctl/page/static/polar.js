// Inclination of the rope as seen from above: tangential to the right, normal upwards, in degrees.
import { Store } from "./store.js";
import { colours, nice, sized } from "./look.js";

const SHADES = 4; // parts of the trail, the oldest the faintest

export class Polar {
  constructor(canvas, label, store) {
    this.canvas = canvas;
    this.label = label;
    this.store = store;
    this.settings = null;
    this.restyle();
  }

  restyle() {
    this.c = colours();
  }

  draw(names) {
    const area = sized(this.canvas), store = this.store;
    if (!area) return;
    const { ctx, width, height } = area, c = this.c;
    const x = names.indexOf("tangential_deg"), y = names.indexOf("normal_deg");
    const radius = Math.min(width, height) / 2 - 16, cx = width / 2, cy = height / 2;
    const reach = this.reach(x, y), px = (deg) => (deg / reach) * radius;
    this.label.textContent = `tangential →, normal ↑, ring ${Number((reach / 2).toPrecision(2))} deg`;
    ctx.font = "12px DejaVu Sans, sans-serif";
    ctx.strokeStyle = c.line;
    ctx.fillStyle = c.dim;
    ctx.lineWidth = 1;
    for (const share of [0.5, 1]) {
      ctx.beginPath();
      ctx.arc(cx, cy, radius * share, 0, 2 * Math.PI);
      ctx.stroke();
      ctx.fillText(`${Number((reach * share).toPrecision(2))}°`, cx + 4, cy - radius * share + 13);
    }
    ctx.beginPath();
    ctx.moveTo(cx - radius, cy);
    ctx.lineTo(cx + radius, cy);
    ctx.moveTo(cx, cy - radius);
    ctx.lineTo(cx, cy + radius);
    ctx.stroke();
    this.limits(ctx, cx, cy, px, radius);
    this.trail(ctx, cx, cy, px, x, y);
  }

  // Range of the outer ring: what is shown, with room, in round numbers.
  reach(x, y) {
    const found = [...(this.store.extremes(x) ?? []), ...(this.store.extremes(y) ?? [])].map(Math.abs);
    return nice(Math.max(0.05, ...found) * 1.15);
  }

  limits(ctx, cx, cy, px, radius) {
    const bounds = (name) => (this.settings?.[name] ?? []).map((limit) => limit.value);
    ctx.save();
    ctx.beginPath();
    ctx.arc(cx, cy, radius, 0, 2 * Math.PI);
    ctx.clip();
    ctx.strokeStyle = this.c.bad;
    ctx.setLineDash([6, 5]);
    ctx.beginPath();
    for (const value of bounds("tangential_deg")) {
      ctx.moveTo(cx + px(value), cy - radius);
      ctx.lineTo(cx + px(value), cy + radius);
    }
    for (const value of bounds("normal_deg")) {
      ctx.moveTo(cx - radius, cy - px(value));
      ctx.lineTo(cx + radius, cy - px(value));
    }
    ctx.stroke();
    ctx.restore();
  }

  trail(ctx, cx, cy, px, x, y) {
    const { store, c } = this, count = Store.BUCKETS;
    ctx.strokeStyle = c.trace;
    ctx.lineWidth = 2;
    let last = null;
    for (let part = 0; part < SHADES; part++) {
      ctx.globalAlpha = 0.15 + (0.85 * (part + 1)) / SHADES;
      ctx.beginPath();
      let drawing = false;
      if (last) ctx.moveTo(...last), (drawing = true);
      for (let i = Math.floor((part * count) / SHADES); i < ((part + 1) * count) / SHADES; i++) {
        const slot = (store.newest + 1 + i) % count;
        const a = (store.low[x][slot] + store.high[x][slot]) / 2, b = (store.low[y][slot] + store.high[y][slot]) / 2;
        if (a !== a || b !== b) {
          drawing = false;
          continue;
        }
        last = [cx + px(a), cy - px(b)];
        if (drawing) ctx.lineTo(...last);
        else ctx.moveTo(...last);
        drawing = true;
      }
      ctx.stroke();
    }
    ctx.globalAlpha = 1;
    if (!last) {
      ctx.fillStyle = c.warn;
      ctx.fillText("no inclination", cx - 44, cy - 8);
      return;
    }
    ctx.fillStyle = c.trace;
    ctx.beginPath();
    ctx.arc(...last, 6, 0, 2 * Math.PI);
    ctx.fill();
    ctx.strokeStyle = c.panel;
    ctx.stroke();
  }
}
