// The alarm table: one row for each cause, as the server folds them; acknowledge and shelve, where that is allowed.
const SIGN = { urgent: "■ 1", high: "▲ 2", low: "▼ 3" };
const byId = (id) => document.getElementById(id);
const clock = (ns) => new Date(ns / 1e6).toLocaleTimeString([], { hour12: false });

export class AlarmTable {
  constructor(session, say) {
    this.session = session;
    this.say = say;
    this.shown = "";
    this.body = document.querySelector("#alarm-table tbody");
    byId("shelve").addEventListener("submit", (event) => {
      event.preventDefault();
      this.decide("shelve", byId("shelve-cause").textContent, { reason: byId("shelve-reason").value.trim(), for_s: Math.round(60 * byId("shelve-minutes").valueAsNumber) });
      byId("shelve").hidden = true;
    });
    byId("shelve-no").addEventListener("click", () => (byId("shelve").hidden = true));
    document.querySelector("#alarm-table").addEventListener("click", (event) => {
      const { act, cause } = event.target.dataset ?? {};
      if (act === "shelve") this.ask(cause);
      else if (act) this.decide(act, cause, {});
    });
  }

  show(rows) {
    const operator = Boolean(this.session.operator), said = JSON.stringify([rows, operator]);
    if (said === this.shown) return; // a button that is being pressed stays the same
    this.shown = said;
    const standing = rows.filter((row) => row.stands && !row.shelved).length, shelved = rows.filter((row) => row.shelved).length;
    byId("alarm-count").textContent = rows.length ? `${standing} standing, ${rows.length - standing - shelved} over, ${shelved} shelved` : "none";
    const focus = document.activeElement?.dataset?.key;
    this.body.replaceChildren(...rows.map((row) => this.row(row, operator)));
    if (focus) [...this.body.querySelectorAll("[data-key]")].find((node) => node.dataset.key === focus)?.focus();
  }

  row(row, operator) {
    const tr = document.createElement("tr");
    tr.className = `${row.priority}${row.stands && !row.shelved ? " stands" : ""}${row.acknowledged ? " seen" : ""}`;
    cell(tr, "").append(span(`${SIGN[row.priority]} ${row.priority.toUpperCase()}`, "badge-of"));
    const cause = cell(tr, "");
    cause.append(span(row.cause, "cause"), span(` ${row.text} `), span(`→ ${row.remedy}`, "remedy"));
    cell(tr, row.value || row.limit ? `${row.value || "-"}, limit ${row.limit || "-"}` : "");
    const times = row.count > 1 ? `first ${clock(row.first_ns)}, last ${clock(row.last_ns)}, ${row.count} times` : clock(row.first_ns);
    cell(tr, `${times}${row.chatters ? ", chatters" : ""}`);
    const state = cell(tr, "");
    const parts = [row.stands ? "stands" : "over", row.acknowledged ? `seen by ${row.acknowledged}` : "not acknowledged"];
    if (row.shelved) parts.push(`shelved until ${clock(row.shelved.until_ns)} by ${row.shelved.operator}: ${row.shelved.reason}`);
    state.append(span(parts.join(", ")));
    if (operator) {
      const buttons = state.appendChild(document.createElement("div"));
      if (!row.acknowledged) buttons.append(button("acknowledge", row.cause));
      buttons.append(button(row.shelved ? "unshelve" : "shelve", row.cause));
    }
    return tr;
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
  node.textContent = act;
  node.setAttribute("aria-label", `${act} ${cause}`);
  Object.assign(node.dataset, { act, cause, key: `${act} ${cause}` });
  return node;
}
