// Commands, where this browser has signed in to a page with operator rights. The server checks everything again.
const byId = (id) => document.getElementById(id);

export class Commands {
  constructor(session) {
    this.session = session;
    this.waiting = null;
    this.mine = false;
    byId("hold").addEventListener("click", () => this.give("hold"));
    byId("take").addEventListener("click", () => this.lease("take"));
    byId("return").addEventListener("click", () => this.lease("return"));
    byId("confirm-yes").addEventListener("click", () => this.confirm());
    byId("confirm-no").addEventListener("click", () => this.ask(null));
    byId("sign-out").addEventListener("click", () => session.leave());
    byId("confirm").addEventListener("keydown", (event) => event.key === "Escape" && this.ask(null));
    byId("newtons").addEventListener("keydown", (event) => event.key === "Enter" && document.querySelector("[data-verb=target]").click());
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
    const mine = (this.mine = Boolean(state.lease?.mine)), foreign = !mine && state.lease && !/^nobody/.test(state.lease.text);
    byId("take").hidden = mine;
    byId("take").textContent = foreign ? "take the lease over" : "take the lease";
    byId("reason").hidden = !foreign;
    byId("return").hidden = !mine;
    byId("verbs").hidden = !mine || Boolean(this.waiting);
    this.verbs(state);
    // What it would do now: the rig goes on while the question stands.
    if (this.waiting && state.asked?.startsWith(this.waiting.text.split(":")[0])) set(byId("confirm-text"), `${state.asked}?`);
  }

  // Only what the modes table allows is live; the rest says why not. Not `disabled`: that could be neither reached nor read.
  verbs(state) {
    const why = [];
    for (const button of document.querySelectorAll("[data-verb]")) {
      const verb = button.dataset.verb, refusal = state.stale ? "no data" : !this.mine ? "take the lease first" : state.verbs?.[verb] ?? "";
      button.setAttribute("aria-disabled", String(Boolean(refusal)));
      button.dataset.why = refusal;
      button.title = refusal;
      if (refusal && this.mine) why.push(`${verb.toUpperCase()}: ${refusal}`);
    }
    set(byId("why-not"), why.length ? `not now: ${why.join(" · ")}` : "");
    byId("why-not").hidden = !this.mine || Boolean(this.waiting);
  }

  async give(verb) {
    this.ask(null);
    this.say(`${verb.toUpperCase()} ...`, true);
    const asked = performance.now();
    const body = { verb };
    if (verb === "target") {
      body.value = byId("newtons").valueAsNumber;
      if (!Number.isFinite(body.value)) return this.say("TARGET: found no number of newtons", false);
    }
    const { ok, answer } = await this.session.post("command", body);
    this.answeredMs = performance.now() - asked;
    if (ok && answer.confirm) this.ask(answer);
    else this.say(answer.text, ok);
  }

  async lease(act) {
    const { ok, answer } = await this.session.post("lease", { act, reason: act === "take" ? byId("reason").value.trim() : "" });
    if (ok) byId("reason").value = "";
    this.say(answer.text, ok);
  }

  ask(proposal) {
    clearTimeout(this.timer);
    this.waiting = proposal;
    const inside = byId("confirm").contains(document.activeElement);
    byId("confirm").hidden = !proposal;
    if (inside && !proposal) byId("hold").focus(); // the focus is never lost
    byId("verbs").hidden = !this.mine || Boolean(proposal);
    if (!proposal) return;
    byId("confirm-text").textContent = `${proposal.text}?`;
    this.say("", true);
    byId("confirm-yes").focus();
    this.timer = setTimeout(() => this.ask(null), proposal.for_s * 1000);
  }

  async confirm() {
    const proposal = this.waiting;
    if (!proposal) return;
    this.ask(null);
    this.say("...", true);
    const { ok, answer } = await this.session.post("confirm", { confirm: proposal.confirm });
    this.say(answer.text, ok);
  }

  say(text, ok) {
    byId("said").textContent = text;
    byId("said").className = ok ? "" : "bad";
  }
}

function set(node, text) {
  if (node.textContent !== text) node.textContent = text;
}
