// Commands, where this browser has signed in to a page with operator rights. The server checks everything again.
const byId = (id) => document.getElementById(id);
const RAMPS = ["TENSIONING", "RELEASING"];

export class Commands {
  constructor(session) {
    this.session = session;
    this.waiting = null;
    this.mine = false;
    byId("hold").addEventListener("click", () => this.give("hold"));
    byId("return").addEventListener("click", () => this.giveBack());
    byId("reason").addEventListener("keydown", (event) => event.key === "Enter" && this.confirm());
    byId("confirm-yes").addEventListener("click", () => this.confirm());
    byId("confirm-no").addEventListener("click", () => this.ask(null));
    byId("sign-out").addEventListener("click", () => session.leave());
    byId("confirm").addEventListener("keydown", (event) => event.key === "Escape" && this.ask(null));
    for (const field of document.querySelectorAll(".target input")) {
      field.addEventListener("keydown", (event) => event.key === "Enter" && field.closest(".target").querySelector("[data-verb]").click());
    }
    for (const button of document.querySelectorAll("[data-verb]")) {
      button.addEventListener("click", () => (button.dataset.why ? this.say(`${button.dataset.verb.toUpperCase()}: ${button.dataset.why}`, false) : this.give(button.dataset.verb)));
    }
  }

  // Read again whenever the server is a new one: it knows no session of the one before.
  async rights() {
    await this.session.look();
    const { operator, signedIn, text } = this.session;
    byId("commands").hidden = !operator;
    byId("rights").textContent = operator ? `commands as ${operator}` : "read-only";
    byId("rights").title = text;
    byId("rights").classList.toggle("rights", Boolean(operator));
    byId("sign-out").hidden = !signedIn;
    this.ask(null);
  }

  show(state) {
    this.mine = Boolean(state.lease?.mine);
    byId("return").hidden = !this.mine;
    set(byId("lease-text"), `lease: ${state.lease?.text ?? "-"}`);
    // What was answered before a fault is no answer to it; a ramp that was begun is not "ramping" any more at its end.
    if (state.mode === "FAULT" && this.mode !== undefined && this.mode !== "FAULT") this.say("", true);
    else if (this.begun && state.mode !== this.begun.mode && this.mode === this.begun.mode) this.say(`${this.begun.verb} has ended: ${state.mode}`, true);
    this.mode = state.mode;
    for (const node of document.querySelectorAll(".in-fault")) node.classList.toggle("away", state.mode !== "FAULT");
    for (const node of document.querySelectorAll("[data-only-in]")) node.classList.toggle("away", state.mode !== node.dataset.onlyIn);
    for (const [id, words] of Object.entries(state.bounds ?? {})) set(byId(`${id}-bounds`), words);
    this.verbs(state);
    byId("hold").classList.toggle("dead", Boolean(state.hold_dead)); // undefined would change it at every message
    byId("hold").title = state.hold_dead ? state.hold : "";
    // What it would do now: the rig goes on while the question stands.
    if (this.waiting && !this.waiting.holder && state.asked?.startsWith(this.waiting.text.split(":")[0])) set(byId("confirm-text"), `${state.asked}?`);
  }

  // Only what the modes table allows is live; the rest says why not, each reason once. Not `disabled`: that could be
  // neither reached nor read.
  verbs(state) {
    for (const button of document.querySelectorAll("[data-verb]")) {
      const refusal = state.stale ? "no data" : state.verbs?.[button.dataset.verb] ?? "no data";
      button.setAttribute("aria-disabled", String(Boolean(refusal)));
      button.dataset.why = refusal;
      button.title = refusal;
    }
    const why = state.stale ? ["all but HOLD: no data"] : state.not_now ?? [];
    set(byId("why-not"), why.length ? `Not now: ${why.join(" · ")}` : "");
  }

  // ``reason``: why the lease is taken over from another, which is asked for where one is held; ``value``: as it was
  // typed before that.
  async give(verb, reason = "", value = undefined) {
    this.ask(null);
    this.say(`${verb.toUpperCase()} ...`, true);
    const asked = performance.now();
    const body = { verb, reason };
    const field = document.querySelector(`[data-verb=${verb}]`)?.closest(".target")?.querySelector("input");
    const mode = field?.closest("[data-only-in]")?.dataset.onlyIn; // a number that is for one mode may be left out
    if (field && !(mode && (mode !== this.mode || !(value ?? field.value)))) body.value = value ?? field.value; // the server reads it, as it reads a command line
    for (const once of document.querySelectorAll("[data-only-in] input")) once.value = ""; // it is for one command alone
    const { ok, answer } = await this.session.post("command", body);
    this.answeredMs = performance.now() - asked;
    if (ok && answer.confirm) this.ask(answer);
    else if (answer.holder) this.ask({ ...answer, verb, value: body.value, for_s: 60 });
    else this.answered(answer, ok);
  }

  async giveBack() {
    const { ok, answer } = await this.session.post("lease", { act: "return", reason: "" });
    this.say(answer.text, ok);
  }

  ask(proposal) {
    clearTimeout(this.timer);
    this.waiting = proposal;
    const inside = byId("confirm").contains(document.activeElement), foreign = Boolean(proposal?.holder);
    byId("confirm").hidden = !proposal;
    byId("said").hidden = byId("why-not").hidden = byId("lease").hidden = Boolean(proposal);
    if (inside && !proposal) byId("hold").focus(); // the focus is never lost
    if (!proposal) return;
    byId("reason").hidden = !foreign;
    byId("reason").value = "";
    byId("confirm-yes").textContent = foreign ? "take over" : "CONFIRM";
    byId("confirm-text").textContent = foreign ? `${proposal.verb.toUpperCase()}: ${proposal.holder} holds the lease. Reason to take it over:` : `${proposal.text}?`;
    this.say("", true);
    byId(foreign ? "reason" : "confirm-yes").focus();
    this.timer = setTimeout(() => this.ask(null), proposal.for_s * 1000);
  }

  async confirm() {
    const proposal = this.waiting;
    if (!proposal) return;
    const reason = byId("reason").value.trim();
    if (proposal.holder && !reason) return byId("reason").focus();
    this.ask(null);
    if (proposal.holder) return this.give(proposal.verb, reason, proposal.value);
    this.say("...", true);
    const { ok, answer } = await this.session.post("confirm", { confirm: proposal.confirm });
    this.answered(answer, ok);
  }

  // ``begun``: a ramp that goes on after the answer, and the mode of it.
  answered(answer, ok) {
    this.say(answer.text, ok);
    if (ok && RAMPS.includes(answer.mode)) this.begun = { verb: String(answer.verb).toUpperCase(), mode: answer.mode };
  }

  say(text, ok) {
    this.begun = null;
    byId("said").textContent = text && text !== "..." ? `${new Date().toLocaleTimeString([], { hour12: false })} ${text}` : text;
    byId("said").className = ok ? "" : "bad";
  }
}

function set(node, text) {
  if (node.textContent !== text) node.textContent = text;
}
