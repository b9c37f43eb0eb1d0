// The alarm table: one row for each cause, as the server folds them; acknowledge and shelve, where that is allowed.
const SIGN = { urgent: "■ 1", high: "▲ 2", low: "▼ 3" };
const byId = (id) => document.getElementById(id);
const clock = (ns) => new Date(ns / 1e6).toLocaleTimeString([], { hour12: false });

export class AlarmTable {
  constructor(session, say) {
    this.session = session;
    this.say = say;
    this.shown = "";
    this.open = new Set(); // causes whose words and remedy are shown
    this.body = document.querySelector("#alarm-table tbody");
    byId("shelve").addEventListener("submit", async (event) => {
      event.preventDefault();
      byId("shelve").hidden = await this.decide("shelve", byId("shelve-cause").textContent, { reason: byId("shelve-reason").value.trim(), minutes: byId("shelve-minutes").value });
    });
    byId("shelve-no").addEventListener("click", () => (byId("shelve").hidden = true));
    this.scroll = document.querySelector("#alarms .scroll");
    this.scroll.addEventListener("scroll", () => this.count());
    byId("more-alarms").addEventListener("click", () => this.scroll.scrollBy({ top: this.scroll.clientHeight - 40 }));
    document.querySelector("#alarm-table").addEventListener("click", (event) => {
      const { act, cause } = event.target.dataset ?? {};
      if (act === "open") this.toggle(cause);
      else if (act === "shelve") this.ask(cause);
      else if (act) this.decide(act, cause, {});
    });
  }

  show(rows, tally) {
    const operator = Boolean(this.session.operator), said = JSON.stringify([rows, operator, tally]);
    if (said === this.shown) return; // a button that is being pressed stays the same
    this.shown = said;
    byId("alarm-count").textContent = tally;
    const focus = document.activeElement?.dataset?.key;
    this.body.replaceChildren(...rows.map((row) => this.row(row, operator)));
    if (focus) [...this.body.querySelectorAll("[data-key]")].find((node) => node.dataset.key === focus)?.focus();
  }

  // How many alarms are below those in sight.
  count() {
    const end = this.scroll.getBoundingClientRect().bottom + 1;
    const below = [...this.body.children].filter((row) => row.getBoundingClientRect().bottom > end).length;
    byId("more-alarms").hidden = below === 0;
    byId("more-alarms").textContent = `▼ ${below} more`;
  }

  row(row, operator) {
    const tr = document.createElement("tr"), open = this.open.has(row.cause);
    tr.className = `${row.priority} ${row.shelved ? "shelved" : row.condition}${row.acknowledged ? " seen" : ""}`;
    const badge = cell(tr, "").appendChild(span(SIGN[row.priority], "badge-of"));
    badge.append(span(` ${row.priority.toUpperCase()}`, "word"));
    const cause = cell(tr, "");
    if (row.follows) cause.append(span("↳ ", "follows")); // from the culprit, under its first alarm
    const name = cause.appendChild(button("open", row.cause));
    name.replaceChildren(...row.cause.split("_").flatMap((part, i) => (i ? ["_", document.createElement("wbr"), part] : [part]))); // a long name breaks behind an underscore
    name.className = "cause";
    name.setAttribute("aria-label", `${row.cause}${row.follows ? ", follows from the cause named above" : ""}: ${open ? "hide" : "show"} its words and remedy`);
    name.setAttribute("aria-expanded", String(open));
    if (open) cause.append(span(` ${row.text} `, "words"), span(`→ ${row.remedy}`, "remedy"));
    cell(tr, row.value || row.limit ? `${row.value || "-"}, limit ${row.limit || "-"}` : "");
    cell(tr, `${clock(row.last_ns)}${row.count > 1 ? ` ×${row.count}` : ""}${row.chatters ? " chatters" : ""}`);
    const state = cell(tr, ""), parts = [row.condition];
    if (row.acknowledged) parts.push(`seen by ${row.acknowledged}`);
    if (row.shelved) parts.push(`shelved until ${clock(row.shelved.until_ns)} by ${row.shelved.operator}: ${row.shelved.reason}`);
    state.append(span(parts.join(", ")));
    if (operator) {
      if (!row.acknowledged) state.append(button("acknowledge", row.cause));
      state.append(button(row.shelved ? "unshelve" : "shelve", row.cause));
    }
    return tr;
  }

  toggle(cause) {
    if (!this.open.delete(cause)) this.open.add(cause);
    const [rows, , tally] = JSON.parse(this.shown);
    this.shown = "";
    this.show(rows, tally);
  }

  ask(cause) {
    byId("shelve").hidden = false;
    byId("shelve-cause").textContent = cause;
    byId("shelve-reason").value = "";
    byId("shelve-reason").focus();
  }

  async decide(act, cause, more) {
    const { ok, answer } = await this.session.post("alarm", { act, cause, ...more });
    this.say(answer.text, ok);
    return ok;
  }
}

function cell(tr, text, style = "") {
  const td = tr.appendChild(document.createElement("td"));
  td.textContent = text;
  if (style) td.className = style;
  return td;
}

function span(text, style = "") {
  const node = document.createElement("span");
  node.textContent = text;
  if (style) node.className = style;
  return node;
}

function button(act, cause) {
  const node = document.createElement("button");
  node.type = "button";
  node.textContent = act === "acknowledge" ? "ack" : act;
  node.setAttribute("aria-label", `${act} ${cause}`);
  Object.assign(node.dataset, { act, cause, key: `${act} ${cause}` });
  return node;
}
