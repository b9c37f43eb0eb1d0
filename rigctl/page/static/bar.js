// Tension as an analogue bar of a fixed scale, with the rig's own limits and the band of the target.
const NS = "http://www.w3.org/2000/svg";
const LEFT = 8, RIGHT = 392, TOP = 18, HIGH = 16;

export class Bar {
  constructor(svg) {
    this.svg = svg;
    this.parts = {};
    this.limits = [null, null];
    this.most = 500;
    for (const [name, kind] of [["track", "rect"], ["band", "rect"], ["goal", "line"], ["lowest", "line"], ["highest", "line"], ["needle", "path"], ["zero", "text"], ["end", "text"], ["mid", "text"], ["low", "text"], ["high", "text"]]) {
      this.parts[name] = svg.appendChild(document.createElementNS(NS, kind));
      this.parts[name].setAttribute("class", /lowest|highest/.test(name) ? "bar-limit" : `bar-${name}`);
    }
    put(this.parts.track, { x: LEFT, y: TOP, width: RIGHT - LEFT, height: HIGH });
  }

  // The scale is that of the rig file, whatever is measured: zero to a quarter above the highest limit.
  set settings(message) {
    this.limits = message.force_limits_n ?? [null, null];
    const highest = Math.max(this.limits[1] ?? 0, message.target_range_n?.[1] ?? 0);
    this.most = highest > 0 ? Math.ceil((1.25 * highest) / 50) * 50 : 500;
  }

  show(value, target, bandPct, regulated) {
    const { band, goal, needle, zero, end, mid, track } = this.parts, known = typeof value === "number", most = this.most;
    const x = (n) => LEFT + (Math.min(Math.max(n, 0), most) / most) * (RIGHT - LEFT);
    const half = (bandPct / 100) * (target || 0), outside = regulated && known && Math.abs(value - target) > half;
    put(band, { x: x(target - half), y: TOP, width: Math.max(0, x(target + half) - x(target - half)), height: HIGH });
    put(goal, { x1: x(target), x2: x(target), y1: TOP - 3, y2: TOP + HIGH + 3 });
    const at = known ? x(value) : LEFT, beyond = known && value > most;
    needle.setAttribute("d", beyond ? `M${RIGHT - 12} ${TOP} l12 8 l-12 8 z` : `M${at - 7} ${TOP - 11} h14 l-7 12 v${HIGH} h-1 v-${HIGH} z`);
    needle.setAttribute("class", known ? `bar-needle${outside || beyond ? " outside" : ""}` : "hidden");
    track.setAttribute("class", known ? "bar-track" : "bar-track idle");
    word(zero, LEFT, "start", "0");
    word(end, RIGHT, "end", `${most} N`);
    word(mid, Math.min(Math.max(x(target), 110), 290), "middle", target > 0 ? `target ${Math.round(10 * target) / 10} N ±${bandPct} %` : "no target");
    for (const [line, name, limit] of [["lowest", "low", this.limits[0]], ["highest", "high", this.limits[1]]]) {
      const there = typeof limit === "number" && limit > 0;
      put(this.parts[line], there ? { x1: x(limit), x2: x(limit), y1: TOP - 4, y2: TOP + HIGH + 4 } : { x1: -9, x2: -9 });
      word(this.parts[name], there ? x(limit) : 0, name === "low" ? "start" : "middle", there ? `limit ${Math.round(10 * limit) / 10}` : "", 12);
    }
    const said = known ? `${value.toFixed(1)} N, target ${target} N, ${outside ? "outside" : "within"} its band of ±${bandPct} %` : "tension not known";
    if (this.said !== said) this.svg.setAttribute("aria-label", (this.said = said));
  }
}

function put(node, attributes) {
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
}

function word(node, x, anchor, text, y = 52) {
  put(node, { x, y, "text-anchor": anchor });
  if (node.textContent !== text) node.textContent = text;
}
