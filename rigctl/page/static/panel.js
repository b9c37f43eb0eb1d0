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
    this.operator = null;
    addEventListener("resize", () => this.fit());
  }

  set settings(message) {
    this.bandPct = message.band_pct;
    this.bar.settings = message;
    this.mimic.range = message.stroke_range_mm.map((end) => end ?? 0);
  }

  show(state) {
    if (state.rig) set(byId("rig"), state.rig);
    set(byId("clock"), new Date(state.server_wall_ms).toLocaleTimeString([], { hour12: false }));
    this.alarms.show(state.alarms ?? [], state.tally);
    if (state.mode === undefined) return;
    document.title = `${state.mode} - ${state.rig}`;
    set(byId("mode"), state.mode);
    byId("mode-box").dataset.mode = state.mode;
    const { origin } = state;
    set(byId("origin-for"), origin ? `for ${duration(state.server_wall_ms - origin.since_ms)}` : "");
    set(byId("origin-clock"), origin ? `, since ${clock(origin.since_ms)}` : "");
    set(byId("origin-by"), origin ? ` · ${origin.by}` : "");
    this.banner(state);
    if (state.values) {
      this.numbers(state, state.values);
      this.mimic.show(state);
      this.list("rows", this.rows(state));
      this.list("devices", state.devices.map(({ name, text, age_ms, bad, sure }) => [name, `${bad ? "▲ " : ""}${text}${age_ms === null ? "" : `, ${age(age_ms)}`}`, [bad ? "yellow" : "", sure ? "" : "inferred"].join(" ").trim()]));
      this.list("timing-rows", this.timing(state));
      this.list("record-rows", this.records(state));
    }
  }

  // One place and one size: what is named first, what follows from it, and numbered steps.
  banner(state) {
    const { parts, text, value, limit, since_ms, follows, active, priority, blocks, does, entry, entry_why, unheld } = state.answers;
    set(byId("does"), does ? `now: ${does}` : "");
    set(byId("entry"), entry);
    set(byId("entry-why"), entry_why);
    byId("entry-box").dataset.entry = entry;
    byId("entry-box").classList.toggle("unheld", unheld);
    const named = parts.length > 0;
    byId("banner").dataset.tone = named ? "fault" : "calm";
    set(byId("cause-caption"), named ? `cause${priority ? ` · priority ${priority}` : ""} · ${active ? "active" : "cleared, latched until RESET"}` : "cause");
    set(byId("cause"), parts.map((part) => part.toUpperCase()).join(" / "));
    const facts = [text];
    if (value || limit) facts.push(`value ${value || "-"}, limit ${limit || "-"}`);
    if (since_ms !== null) facts.push(`since ${clock(since_ms)} (${duration(state.server_wall_ms - since_ms)})`);
    const lines = [facts.filter(Boolean).join(" · ")];
    if (blocks) lines.push(/^nothing/.test(blocks) ? `RESET is blocked by ${blocks.replace(": RESET is accepted", "")}` : `RESET is blocked by ${few(blocks)}`);
    if (follows.length) lines.push(`+${follows.length} that follow: ${few(follows.join(", "))}`);
    if (!named) lines[0] = text;
    set(byId("cause-text"), lines.filter(Boolean).join("\n"));
    if (!document.body.classList.contains("stale")) this.steps(state.answers.steps);
  }

  steps(steps) {
    const said = JSON.stringify([steps, this.operator]);
    if (said === this.stepsSaid) return;
    this.stepsSaid = said;
    byId("steps").replaceChildren(...steps.map(({ text, verb }) => {
      const item = element("li", text);
      if (verb && !this.operator) item.append(element("span", ` (rigctl ${verb})`, "quiet"));
      return item;
    }));
  }

  // Large words that do not fit are drawn smaller, never cut; after every change of words, size or view.
  fit() {
    for (const node of document.querySelectorAll(".big, #steps, #cause-text, .under")) {
      const said = `${node.textContent} ${node.clientWidth} ${node.clientHeight}`;
      if (node.dataset.fitted === said) continue;
      node.style.fontSize = "";
      const full = parseFloat(getComputedStyle(node).fontSize);
      for (let px = full; px > 11 && (node.scrollWidth > node.clientWidth + 1 || (!node.matches(".big") && node.scrollHeight > node.clientHeight + 1)); px *= 0.94) node.style.fontSize = `${px}px`;
      node.dataset.fitted = `${node.textContent} ${node.clientWidth} ${node.clientHeight}`;
    }
  }

  numbers(state, values) {
    const doubts = state.doubts ?? {}, regulated = REGULATED.includes(state.mode);
    const { vertical_n } = values, there = typeof vertical_n === "number", words = there ? newtons(vertical_n) : "-";
    this.value(byId("vertical"), words, there ? doubts.tension : undefined);
    const known = !("tension" in doubts), compensating = known && typeof values.error_n === "number";
    const outside = compensating && !state.ramping && values.error_pct > this.bandPct;
    byId("vertical").closest(".tension").classList.toggle("outside", outside);
    set(byId("error"), !known ? `▲ not to be trusted: ${doubts.tension}` : state.ramping ? `on the way to ${fixed(values.target_n, 1, "N")}` : compensating ? `${outside ? "▲ " : ""}error ${signed(values.error_n, 2, "N")} (${fixed(values.error_pct, 2, "%")})` : state.mode === "TENSIONING" ? `on the way to ${fixed(values.target_n, 1, "N")}` : "not regulated");
    this.bar.show(known ? values.vertical_n : null, values.target_n, this.bandPct, regulated);
    for (const { name, label, text, doubt } of state.figures) this.value(this.figure(name, label), text, doubt ?? undefined);
  }

  // Made once, so that it can be selected.
  figure(name, label) {
    const found = byId(`value-${name}`);
    if (found) return found;
    const value = element("dd", "-");
    value.id = `value-${name}`;
    byId("values").append(element("dt", label), value);
    return value;
  }

  // A value that is not trusted is struck through, with why.
  value(node, text, doubt) {
    node.classList.toggle("doubtful", doubt !== undefined);
    set(node, text);
    if (doubt !== undefined) node.title = doubt;
    else node.removeAttribute("title");
  }

  rows(state) {
    const rows = [];
    if (state.limits?.length) rows.push(["limits", state.limits.join("; "), "yellow"]);
    if (state.flags) rows.push(["flags", state.flags, ""]);
    if (state.flaws) rows.push(["signals", state.flaws, "yellow"]);
    for (const [words, style] of state.checks ?? []) rows.push([rows.some(([label]) => label === BEFORE) ? "" : BEFORE, words, style]);
    rows.push(["lease", state.lease.text, ""]);
    if (state.samples_lost) rows.push(["lost here", `${state.samples_lost} samples`, "yellow"]);
    return rows;
  }

  timing(state) {
    const rows = [["summary", state.timing.text, ""]];
    rows.push(["lateness", state.lateness, ""], ["work", state.work, ""], ["skipped", `${state.values.skipped} of ${state.values.tick} ticks`, ""]);
    rows.push(["bus", state.bus, state.bus_bad ? "yellow" : ""]);
    if (state.design) rows.push(["design", state.design, ""]);
    if (state.margins) rows.push(["margins", state.margins, ""]);
    return rows;
  }

  records(state) {
    const rows = [["calibration", ...state.calibration], ["recorder", ...state.recorder], ["daemon", state.endpoint, ""]];
    for (const words of state.warnings) rows.push(["warning", words, ""]);
    return rows;
  }

  list(id, rows) {
    const said = JSON.stringify(rows);
    if (said === this.lists.get(id)) return; // untouched rows can be selected and scrolled
    this.lists.set(id, said);
    byId(id).replaceChildren(...rows.flatMap(([label, words, style]) => [element("dt", label), element("dd", words, style)]));
  }
}

// Of an unloaded cell the noise is not shown.
const UNLOADED_N = 0.5;
const newtons = (value) => (Math.abs(value) < UNLOADED_N ? "0" : value.toFixed(2));
const clock = (ms) => new Date(ms).toLocaleTimeString([], { hour12: false });
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
