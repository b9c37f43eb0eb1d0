// Tension as an analogue bar: the band of the target, the value as a pointer, the ends with their unit.
const NS = "http://www.w3.org/2000/svg";
const LEFT = 6, RIGHT = 394, ABOUT = 0.1; // ± 10 % of the target once the value is near it

export class Bar {
  constructor(svg) {
    this.svg = svg;
    this.parts = {};
    for (const [name, kind] of [["track", "rect"], ["band", "rect"], ["goal", "line"], ["needle", "path"], ["low", "text"], ["high", "text"], ["mid", "text"]]) {
      this.parts[name] = svg.appendChild(document.createElementNS(NS, kind));
      this.parts[name].setAttribute("class", `bar-${name}`);
    }
    put(this.parts.track, { x: LEFT, y: 10, width: RIGHT - LEFT, height: 16 });
  }

  show(value, target, bandPct, regulated) {
    const { band, goal, needle, low, high, mid, track } = this.parts, known = typeof value === "number";
    const near = known && target > 0 && Math.abs(value - target) < 1.5 * ABOUT * target;
    const from = near ? target * (1 - ABOUT) : 0, to = near ? target * (1 + ABOUT) : Math.max(1.2 * (target || 0), known ? value : 0, 10);
    const x = (n) => LEFT + ((Math.min(Math.max(n, from), to) - from) / (to - from)) * (RIGHT - LEFT);
    const half = (bandPct / 100) * (target || 0), outside = regulated && known && Math.abs(value - target) > half;
    put(band, { x: x(target - half), y: 10, width: Math.max(0, x(target + half) - x(target - half)), height: 16 });
    put(goal, { x1: x(target), x2: x(target), y1: 6, y2: 30 });
    const at = known ? x(value) : LEFT;
    needle.setAttribute("d", `M${at - 8} 0 h16 l-8 13 v19 h-1 v-19 z`);
    needle.setAttribute("class", known ? `bar-needle${outside ? " outside" : ""}` : "hidden");
    track.setAttribute("class", regulated ? "bar-track" : "bar-track idle");
    word(low, LEFT, "start", `${Math.round(from)} N`);
    word(high, RIGHT, "end", `${Math.round(to)} N`);
    word(mid, Math.min(Math.max(x(target), 160), 240), "middle", target > 0 ? `target ${Math.round(10 * target) / 10} N ±${bandPct} %` : "no target");
    const said = known ? `${value.toFixed(1)} N, target ${target} N, ${outside ? "outside" : "within"} its band of ±${bandPct} %` : "tension not known";
    if (this.said !== said) this.svg.setAttribute("aria-label", (this.said = said));
  }
}

function put(node, attributes) {
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
}

function word(node, x, anchor, text) {
  put(node, { x, y: 47, "text-anchor": anchor });
  if (node.textContent !== text) node.textContent = text;
}
