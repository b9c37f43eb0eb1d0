// The history of events with its filters; the computer's own timing is left out unless it is asked for.
const byId = (id) => document.getElementById(id);
const KINDS = ["error", "warning", "info"];

export class History {
  constructor() {
    this.events = [];
    byId("filters").addEventListener("input", () => this.draw());
    byId("filters").addEventListener("submit", (event) => event.preventDefault());
  }

  take(events) {
    this.events = events;
    this.draw();
  }

  // Events for the charts: what an operator would ask about.
  get marks() {
    return this.events.filter((event) => event.severity === "error" || event.kind === "MODE");
  }

  draw() {
    const shown = new Set(KINDS.filter((kind) => byId(`show-${kind}`).checked)), timing = byId("show-timing").checked;
    const text = byId("show-text").value.trim().toLowerCase();
    const rows = this.events.filter((event) => shown.has(event.severity) && (timing || !event.timing) && event.text.toLowerCase().includes(text));
    byId("event-list").replaceChildren(...rows.toReversed().map((event) => {
      const row = document.createElement("li"), time = document.createElement("time"), said = document.createElement("span");
      row.className = event.severity;
      time.textContent = new Date(event.wall_ms).toLocaleTimeString([], { hour12: false });
      said.textContent = event.text;
      const sign = document.createElement("span");
      sign.textContent = { error: "■", warning: "▲", info: "" }[event.severity];
      sign.setAttribute("aria-label", event.severity);
      sign.setAttribute("role", "img");
      if (event.severity === "info") sign.removeAttribute("role"), sign.removeAttribute("aria-label");
      row.append(time, sign, said);
      return row;
    }));
  }
}
