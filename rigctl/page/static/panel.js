// Everything that is said in words and numbers.
const byId = (id) => document.getElementById(id);
const fixed = (value, digits, unit) => (typeof value === "number" ? `${value.toFixed(digits)} ${unit}` : "-");
const signed = (value, digits, unit) => (typeof value === "number" && value >= 0 ? "+" : "") + fixed(value, digits, unit);

const BEFORE = "before arming";
const REGULATED = ["TENSIONING", "COMPENSATING", "RELEASING"];

export class Panel {
  constructor(bar, mimic, alarms) {
    this.bar = bar;
    this.mimic = mimic;
    this.alarms = alarms;
    this.lists = new Map();
    this.bandPct = 5;
  }

  set settings(message) {
    this.bandPct = message.band_pct;
    this.mimic.range = message.stroke_range_mm.map((end) => end ?? 0);
  }

  show(state) {
    if (state.rig) set(byId("rig"), state.rig);
    set(byId("clock"), new Date(state.server_wall_ms).toLocaleTimeString([], { hour12: false }));
    this.alarms.show(state.alarms ?? []);
    if (state.mode === undefined) return;
    document.title = `${state.mode} - ${state.rig}`;
    set(byId("mode"), state.mode);
    byId("mode").dataset.mode = state.mode;
    this.banner(state);
    if (!state.values) return;
    this.numbers(state, state.values);
    this.mimic.show(state);
    this.list("rows", this.rows(state));
    this.list("devices", state.devices.map(({ name, text, age_ms, bad }) => [name, `${bad ? "▲ " : ""}${text}${age_ms === null ? "" : `, ${age(age_ms)}`}`, bad ? "yellow" : ""]));
    this.list("timing-rows", this.timing(state));
    set(byId("light"), state.timing.good ? "● in time" : `▲ ${state.timing.text}`);
    byId("light").classList.toggle("late", !state.timing.good);
  }

  // The strongest cause, its value and limit, since when; what the rig does now, what blocks a reset, what comes next;
  // then every other cause: with many of them the answers stay in sight.
  banner(state) {
    const { causes, does, blocks, next, entry } = state.answers, why = state.why;
    set(byId("does"), does ? `now: ${does}` : "");
    set(byId("next"), next ? `next: ${next}` : "");
    set(byId("entry"), entry ? `entry: ${entry}` : "");
    byId("entry").className = "";
    const lines = causes.map((cause) => {
      const parts = [`${cause.stands ? "■ " : "□ "}${cause.fault}: ${cause.text}`];
      if (cause.since_ms !== null) parts.push(`since ${new Date(cause.since_ms).toLocaleTimeString([], { hour12: false })} (${duration(state.server_wall_ms - cause.since_ms)})`);
      if (cause.value || cause.limit) parts.push(`value ${cause.value || "-"}, limit ${cause.limit || "-"}`);
      parts.push(cause.stands ? (cause.blocks ? "blocks a reset" : "stands") : "over, latched until the reset");
      return parts.join(" · ");
    });
    if (!lines.length && why) lines.push(`■ ${why}`);
    if (lines.length) lines.splice(1, 0, `Now: ${does}. Reset: ${blocks ? (/^nothing/.test(blocks) ? "is accepted" : `blocked by ${few(blocks)}`) : "not needed"}.`, `Next: ${next || "-"}`);
    byId("alarm").hidden = !lines.length;
    set(byId("alarm-first"), lines.slice(0, 3).join("\n"));
    set(byId("alarm-others"), lines.slice(3).join("\n"));
    byId("next").hidden = lines.length > 0;
  }

  numbers(state, values) {
    const inclination = state.inclination ?? "good", flaws = state.flaws ?? "", regulated = REGULATED.includes(state.mode);
    const n = typeof values.vertical_n === "number" ? values.vertical_n.toFixed(2) : "-";
    set(byId("vertical"), n === "-0.00" ? "0.00" : n);
    const compensating = typeof values.error_n === "number", outside = compensating && values.error_pct > this.bandPct;
    byId("vertical").closest(".tension").classList.toggle("outside", outside);
    set(byId("error"), compensating ? `${outside ? "▲ " : ""}error ${signed(values.error_n, 2, "N")} (${fixed(values.error_pct, 2, "%")})` : "not regulated");
    this.bar.show(values.vertical_n, values.target_n, this.bandPct, regulated);
    set(byId("target"), fixed(values.target_n, 1, "N"));
    set(byId("stroke"), fixed(values.stroke_mm, 2, "mm"));
    set(byId("speed"), signed(values.speed_mm_s, 2, "mm/s"));
    for (const axis of ["tangential", "normal"]) {
      set(byId(axis), signed(values[`${axis}_deg`], 3, "°"));
      byId(axis).className = inclination === "good" ? "" : "flaw";
    }
    byId("stroke").className = byId("speed").className = flaws.includes("drive") ? "flaw" : "";
  }

  rows(state) {
    const rows = [];
    if (state.limits?.length) rows.push(["limits", state.limits.join("; "), "yellow"]);
    if (state.flags) rows.push(["flags", state.flags, ""]);
    if (state.flaws) rows.push(["signals", state.flaws, "yellow"]);
    if (state.inclination && state.inclination !== "good") rows.push(["inclination", state.inclination, "yellow"]);
    for (const [words, style] of state.checks ?? []) rows.push([rows.some(([label]) => label === BEFORE) ? "" : BEFORE, words, style]);
    rows.push(["calibration", ...state.calibration], ["lease", state.lease.text, ""], ["recorder", ...state.recorder]);
    for (const words of state.warnings) rows.push(["warning", words, "yellow"]);
    if (state.samples_lost) rows.push(["lost here", `${state.samples_lost} samples`, "yellow"]);
    rows.push(["daemon", state.endpoint, ""]);
    return rows;
  }

  timing(state) {
    const rows = [["summary", state.timing.text, state.timing.good ? "" : "yellow"]];
    rows.push(["lateness", state.lateness, ""], ["work", state.work, ""], ["skipped", `${state.values.skipped} of ${state.values.tick} ticks`, ""]);
    rows.push(["bus", state.bus, state.bus_bad ? "yellow" : ""]);
    if (state.design) rows.push(["design", state.design, ""]);
    if (state.margins) rows.push(["margins", state.margins, ""]);
    return rows;
  }

  list(id, rows) {
    const said = JSON.stringify(rows);
    if (said === this.lists.get(id)) return; // untouched rows can be selected and scrolled
    this.lists.set(id, said);
    byId(id).replaceChildren(...rows.flatMap(([label, words, style]) => [element("dt", label), element("dd", words, style)]));
  }
}

const age = (ms) => (ms < 1000 ? `${ms.toFixed(0)} ms old` : `${(ms / 1000).toFixed(1)} s old`);

function duration(ms) {
  const s = Math.max(0, Math.floor(ms / 1000));
  return s < 60 ? `${s} s` : s < 3600 ? `${Math.floor(s / 60)} min ${s % 60} s` : `${Math.floor(s / 3600)} h ${Math.floor((s % 3600) / 60)} min`;
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

// The first of several names, and how many more there are.
function few(names) {
  const all = names.split(", ");
  return all.length > 4 ? `${all.slice(0, 3).join(", ")} and ${all.length - 3} more` : names;
}
