// The rig as it is now: rail, cylinder with stroke and ends, brake, drive, rope at its angle x20, spring, payload.
const TIMES = 20, MOST_DEG = 38; // of the drawing; beyond it the angle is only told
const TOP = 78, TRAVEL = 70, ROD = 150; // cylinder: upper end, drawn travel, rod's end at the lowest stroke
const PARTS = `
<rect class="rail" x="30" y="34" width="380" height="14"/>
<text class="label" x="34" y="26">rail</text>
<rect class="carriage" x="176" y="44" width="68" height="26"/>
<g id="m-drive"><circle cx="282" cy="60" r="19"/><text x="282" y="67" text-anchor="middle">M</text></g>
<text id="m-drive-text" x="308" y="58">drive</text>
<text id="m-brake-text" x="290" y="112">brake</text>
<rect class="cylinder" x="192" y="70" width="36" height="84"/>
<rect id="m-rod" class="rod" x="204" y="80" width="12" height="80"/>
<g id="m-brake"><rect id="m-shoe-1" width="20" height="22" y="94"/><rect id="m-shoe-2" width="20" height="22" y="94"/></g>
<g class="scale"><line x1="120" x2="120" y1="80" y2="150"/><line x1="112" x2="128" y1="80" y2="80"/><line x1="112" x2="128" y1="150" y2="150"/>
<text id="m-max" x="106" y="85" text-anchor="end"></text><text id="m-min" x="106" y="155" text-anchor="end"></text>
<path id="m-stroke" d="M122 0 l12 -7 v14 z"/><text id="m-stroke-text" x="106" y="0" text-anchor="end"></text></g>
<g id="m-hang"><path id="m-rope" class="rope"/><path id="m-spring" class="spring"/><rect id="m-load" class="load" x="-48" y="166" width="96" height="46"/><text id="m-load-text" x="0" y="195" text-anchor="middle">payload</text></g>
<line class="plumb" x1="210" x2="210" y1="160" y2="384"/>
<text id="m-tension" x="290" y="152"></text><text id="m-pull" class="label" x="290" y="171"></text>
<text id="m-angle" x="290" y="202"></text><text id="m-drawn" class="label" x="290" y="221"></text>`;

export class Mimic {
  constructor(svg) {
    this.svg = svg;
    svg.innerHTML = PARTS;
    this.part = Object.fromEntries([...svg.querySelectorAll("[id]")].map((node) => [node.id.slice(2), node]));
    this.range = [0, 100];
    this.said = "";
  }

  show(state) {
    const { part } = this, values = state.values ?? {}, on = (state.flag_names ?? []).includes("drive_enabled");
    const [low, high] = this.range, stroke = values.stroke_mm, known = typeof stroke === "number";
    const share = known ? Math.min(Math.max((stroke - low) / (high - low || 1), 0), 1) : 0.5;
    const end = ROD + 10 + TRAVEL * 0.5 * (1 - share); // a longer stroke shortens the rope
    set(part.rod, { height: end - 80 });
    set(part.drive, { class: on ? "on" : "off" });
    text(part["drive-text"], on ? "drive on" : "drive off");
    set(part["shoe-1"], { x: on ? 166 : 184 });
    set(part["shoe-2"], { x: on ? 234 : 216 });
    set(part.brake, { class: on ? "open" : "closed" });
    text(part["brake-text"], on ? "brake open" : "brake closed");
    text(part.max, `${high} mm`);
    text(part.min, `${low} mm`);
    const y = 150 - share * TRAVEL, near = known && (share < 0.05 || share > 0.95);
    set(part.stroke, { transform: `translate(0 ${y})`, class: known ? (near ? "near" : "") : "hidden" });
    set(part["stroke-text"], { y: share > 0.82 ? y + 26 : share < 0.18 ? y - 12 : y + 5 });
    text(part["stroke-text"], known ? `${stroke.toFixed(1)} mm${near ? " END" : ""}` : "stroke ?");
    this.hang(values, end);
    this.tell(state, on);
  }

  hang(values, end) {
    const { part } = this, angle = values.tangential_deg, tension = values.tension_n;
    const drawn = typeof angle === "number" ? Math.min(Math.max(TIMES * angle, -MOST_DEG), MOST_DEG) : 0;
    const slack = typeof tension === "number" && tension < 2;
    set(part.hang, { transform: `translate(210 ${end}) rotate(${-drawn})` });
    set(part.rope, { d: slack ? "M0 0 q9 12 0 24 t0 24 t0 24 t0 24" : "M0 0 V96", class: slack ? "rope slack" : "rope" });
    const zig = Array.from({ length: 8 }, (_, i) => `L${i % 2 ? -9 : 9} ${102 + 7 * i}`).join(" ");
    set(part.spring, { d: `M0 96 ${zig} L0 160 V166` });
    text(part.tension, typeof tension === "number" ? `${Math.abs(tension) < 0.05 ? "0.0" : tension.toFixed(1)} N` : "tension ?");
    text(part.pull, slack ? "rope slack" : "in the rope");
    const beyond = typeof angle === "number" && Math.abs(TIMES * angle) > MOST_DEG;
    text(part.angle, typeof angle === "number" ? `${angle < 0 ? "" : "+"}${angle.toFixed(2)}°` : "angle ?");
    text(part.drawn, beyond ? "off the drawing" : `drawn ×${TIMES}`);
  }

  tell(state, on) {
    const said = `${state.mode}: drive ${on ? "on, brake open" : "off, brake closed"}; ${state.answers?.does ?? ""}`;
    if (said !== this.said) this.svg.setAttribute("aria-label", (this.said = said));
  }
}

function set(node, attributes) {
  for (const [name, value] of Object.entries(attributes)) {
    const now = String(value);
    if (node.getAttribute(name) !== now) node.setAttribute(name, now);
  }
}

function text(node, words) {
  if (node.textContent !== words) node.textContent = words;
}
