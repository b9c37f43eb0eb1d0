// Everything that is said in words and numbers.
const byId = (id) => document.getElementById(id);
const fixed = (value, digits, unit) => (typeof value === "number" ? `${value.toFixed(digits)} ${unit}` : "-");
const signed = (value, digits, unit) => (typeof value === "number" && value >= 0 ? "+" : "") + fixed(value, digits, unit);

const BEFORE = "before arming";

export class Panel {
  constructor() {
    this.rows = "";
  }

  show(state) {
    if (state.rig) byId("rig").textContent = state.rig;
    byId("clock").textContent = new Date(state.server_wall_ms).toLocaleTimeString([], { hour12: false });
    if (state.mode === undefined) return;
    document.title = `${state.mode} - ${state.rig}`;
    set(byId("mode"), state.mode);
    byId("mode").dataset.mode = state.mode;
    byId("alarm").hidden = !state.why;
    set(byId("alarm"), [state.why, ...(state.causes ?? []).map((words) => `stands: ${words}`)].join("\n"));
    const values = state.values ?? {};
    this.numbers(values, state.inclination ?? "good", state.flaws ?? "");
    this.list(state);
  }

  numbers(values, inclination, flaws) {
    const n = typeof values.vertical_n === "number" ? values.vertical_n.toFixed(2) : "-";
    set(byId("vertical"), n === "-0.00" ? "0.00" : n);
    const compensating = typeof values.error_n === "number", inside = compensating && values.error_pct <= 5;
    byId("vertical").closest(".tension").className = `tension ${compensating ? (inside ? "inside" : "outside") : ""}`;
    set(byId("error"), compensating ? `error ${signed(values.error_n, 3, "N")} (${fixed(values.error_pct, 3, "%")})` : "not COMPENSATING");
    set(byId("target"), fixed(values.target_n, 1, "N"));
    set(byId("stroke"), fixed(values.stroke_mm, 2, "mm"));
    set(byId("speed"), signed(values.speed_mm_s, 2, "mm/s"));
    for (const axis of ["tangential", "normal"]) {
      set(byId(axis), signed(values[`${axis}_deg`], 3, "°"));
      byId(axis).className = inclination === "good" ? "" : "flaw";
    }
    byId("stroke").className = byId("speed").className = flaws.includes("drive") ? "flaw" : "";
  }

  list(state) {
    const rows = [["limits", state.limits?.length ? state.limits.join("; ") : "none exceeded", state.limits?.length ? "yellow" : ""]];
    rows.push(["flags", state.flags || "-", state.flags ? "yellow" : ""]);
    if (state.flaws) rows.push(["signals", state.flaws, "yellow"]);
    if (state.inclination && state.inclination !== "good") rows.push(["inclination", state.inclination, "yellow"]);
    for (const [words, style] of state.checks ?? []) rows.push([rows.at(-1)[0] === BEFORE || rows.at(-1)[0] === "" ? "" : BEFORE, words, style]);
    rows.push(["calibration", ...state.calibration], ["lease", state.lease.text, ""], ["recorder", ...state.recorder]);
    for (const words of state.warnings) rows.push(["warning", words, "yellow"]);
    if (state.bus) rows.push(["bus", state.bus, state.bus_bad ? "yellow" : ""], ["lateness", state.lateness, ""], ["work", state.work, ""]);
    if (state.values) rows.push(["skipped", `${state.values.skipped} of ${state.values.tick} ticks`, state.values.skipped ? "yellow" : ""]);
    if (state.values?.move) rows.push(["move", `${state.values.move}, learnt speed ${signed(state.values.learned_mm_s, 3, "mm/s")}`, ""]);
    if (state.design) rows.push(["design", state.design, ""]);
    if (state.margins) rows.push(["margins", state.margins, ""]);
    if (state.samples_lost) rows.push(["lost here", `${state.samples_lost} samples`, "yellow"]);
    rows.push(["daemon", state.endpoint, ""]);
    const said = JSON.stringify(rows);
    if (said === this.rows) return; // untouched rows can be selected and scrolled
    this.rows = said;
    byId("rows").replaceChildren(...rows.flatMap(([label, words, style]) => [element("dt", label), element("dd", words, style)]));
  }

  events(events) {
    const rows = events.toReversed().map((event) => {
      const row = element("li", "", event.severity);
      row.append(element("time", new Date(event.wall_ms).toLocaleTimeString([], { hour12: false })), element("span", event.text));
      return row;
    });
    byId("event-list").replaceChildren(...rows);
  }
}

function set(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

function element(name, text, style = "") {
  const node = document.createElement(name);
  node.textContent = text;
  if (style) node.className = style;
  return node;
}
