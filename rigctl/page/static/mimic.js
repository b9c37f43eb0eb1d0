// The rig as it is now: rail, cylinder with stroke and ends, brake, drive, rope at its angle x20, spring, payload.
const TIMES = 20, MOST_DEG = 38; // of the drawing; beyond it the angle is only told
const FLOOR = 396, LOAD_HIGH = 46, HANGS = 148; // lower end of the rope and spring
const TOP = 78, TRAVEL = 70, ROD = 150; // cylinder: upper end, drawn travel, rod's end at the lowest stroke
const PARTS = `
<rect class="rail" x="30" y="34" width="380" height="14"/>
<text class="label" x="34" y="26">rail</text>
<line class="floor" x1="70" x2="350" y1="398" y2="398"/><text class="label" x="356" y="403">floor</text>
<path id="m-path" class="path" d=""/>
<rect class="carriage" x="176" y="48" width="68" height="26"/>
<g id="m-drive"><circle cx="282" cy="82" r="17"/><text x="282" y="89" text-anchor="middle">M</text></g>
<text id="m-drive-text" x="306" y="88">drive</text>
<rect class="cylinder" x="192" y="74" width="36" height="80"/>
<rect id="m-rod" class="rod" x="204" y="80" width="12" height="80"/>
<g id="m-brake"><rect id="m-shoe-1" width="20" height="22" y="112"/><rect id="m-shoe-2" width="20" height="22" y="112"/></g>
<text id="m-brake-text" class="inferred" x="264" y="129">brake</text>
<text id="m-held" class="label inferred" x="264" y="150"></text>
<g class="scale"><line x1="120" x2="120" y1="80" y2="150"/><line x1="112" x2="128" y1="80" y2="80"/><line x1="112" x2="128" y1="150" y2="150"/>
<text id="m-max" x="106" y="85" text-anchor="end"></text><text id="m-min" x="106" y="155" text-anchor="end"></text>
<path id="m-stroke" d="M122 0 l12 -7 v14 z"/><text id="m-stroke-text" x="106" y="0" text-anchor="end"></text></g>
<g id="m-hang"><path id="m-rope" class="rope"/><path id="m-spring" class="spring"/><rect id="m-load" class="load" x="-48" y="148" width="96" height="46"/><text id="m-load-text" x="0" y="177" text-anchor="middle">payload</text></g>
<line class="plumb" x1="210" x2="210" y1="160" y2="396"/>
<text id="m-tension" x="286" y="196"></text><text id="m-pull" class="label" x="286" y="215"></text>
<text id="m-angle" x="286" y="248"></text><text id="m-drawn" class="label" x="286" y="267"></text>`;

export class Mimic {
  constructor(svg) {
    this.svg = svg;
    svg.innerHTML = PARTS;
    this.part = Object.fromEntries([...svg.querySelectorAll("[id]")].map((node) => [node.id.slice(2), node]));
    this.range = [0, 100];
    this.said = "";
  }

  show(state) {
    const { part } = this, values = state.values ?? {}, doubts = state.doubts ?? {}, { drive, brake } = state;
    const [low, high] = this.range, stroke = values.stroke_mm, known = typeof stroke === "number", sure = known && !("drive" in doubts);
    const share = known ? Math.min(Math.max((stroke - low) / (high - low || 1), 0), 1) : 0.5;
    const end = ROD + 10 + TRAVEL * 0.5 * (1 - share); // a longer stroke shortens the rope
    set(part.rod, { height: end - 80, class: sure ? "rod" : "rod unknown" });
    set(part.drive, { class: drive === "on" ? "on" : drive === "off" ? "off" : "unknown" });
    text(part["drive-text"], `drive ${drive}`);
    const apart = brake === "open" ? 18 : brake === "closed" ? 0 : 9;
    set(part["shoe-1"], { x: 184 - apart });
    set(part["shoe-2"], { x: 216 + apart });
    set(part.brake, { class: brake === "closed" ? "closed" : brake === "open" ? "open" : "unknown" });
    text(part["brake-text"], `brake ${brake}`);
    text(part.max, `${high} mm`);
    text(part.min, `${low} mm`);
    const y = 150 - share * TRAVEL, near = sure && (share < 0.05 || share > 0.95);
    set(part.stroke, { transform: `translate(0 ${y})`, class: sure ? (near ? "near" : "") : "hidden" });
    set(part["stroke-text"], { y: share > 0.82 ? y + 26 : share < 0.18 ? y - 12 : y + 5, class: known && !sure ? "doubtful" : "" });
    text(part["stroke-text"], known ? `${stroke.toFixed(1)} mm${near ? " END" : ""}` : "stroke ?");
    this.path(state, end);
    this.hang(values, doubts, end);
    this.tell(state);
  }

  // What carries the load: from the rail through motor or brake, rod and rope to the payload; dots where it is inferred.
  path(state, end) {
    const by = state.drive === "not known" ? "UNKNOWN" : state.held_by;
    const through = { MOTOR: "M210 41 L282 82 L210 108", NOTHING: "M210 41 L282 82 L210 108", BRAKE: "M210 41 V112" }[by];
    const words = { MOTOR: "motor carries", NOTHING: "motor moves it", BRAKE: "brake carries", CLOSING: "brake closing", TAKING: "motor takes it" }[by] ?? "what carries: not known";
    set(this.part.path, { d: through ? `${through} V${end}` : "", class: by === "BRAKE" ? "path inferred" : "path" });
    text(this.part.held, words);
  }

  hang(values, doubts, end) {
    const { part } = this, angle = values.tangential_deg, tension = values.tension_n;
    const sure = typeof tension === "number" && !("tension" in doubts), angleSure = typeof angle === "number" && !("inclination" in doubts);
    const drawn = angleSure ? Math.min(Math.max(TIMES * angle, -MOST_DEG), MOST_DEG) : 0;
    const slack = sure && tension < 2;
    set(part.hang, { transform: `translate(210 ${end}) rotate(${slack ? 0 : -drawn})` });
    const top = slack ? FLOOR - end - LOAD_HIGH : HANGS; // a slack rope holds nothing: the payload is on the floor
    set(part.load, { y: top });
    set(part["load-text"], { y: top + 29 });
    set(part.rope, { d: slack ? "M0 0 q9 10 0 20 t0 20 t0 20 t0 20" : "M0 0 V80", class: sure ? (slack ? "rope slack" : "rope") : "rope unknown" });
    const zig = Array.from({ length: 8 }, (_, i) => `L${i % 2 ? -9 : 9} ${86 + 7 * i}`).join(" ");
    set(part.spring, { d: `M0 80 ${zig} L0 142 V${top}`, class: sure ? "spring" : "spring unknown" });
    set(part.tension, { class: sure || typeof tension !== "number" ? "" : "doubtful" });
    text(part.tension, typeof tension === "number" ? `${Math.abs(tension) < 0.05 ? "0.0" : tension.toFixed(1)} N` : "tension ?");
    text(part.pull, sure ? (slack ? "rope slack" : "in the rope") : "not to be trusted");
    const beyond = angleSure && Math.abs(TIMES * angle) > MOST_DEG;
    set(part.angle, { class: typeof angle === "number" && !angleSure ? "doubtful" : "" });
    text(part.angle, typeof angle === "number" ? `${angle < 0 ? "" : "+"}${angle.toFixed(2)}°` : "angle ?");
    text(part.drawn, !angleSure ? "not to be trusted" : beyond ? "off the drawing" : `drawn ×${TIMES}`);
  }

  tell(state) {
    const said = `${state.mode}: drive ${state.drive}, brake ${state.brake}; ${state.answers?.does ?? ""}`;
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
