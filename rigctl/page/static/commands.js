// Commands, where the page was opened with the token its server printed. The server checks everything again.
const byId = (id) => document.getElementById(id);

function takeToken() {
  const found = new URLSearchParams(location.hash.slice(1)).get("token");
  try {
    if (found) {
      sessionStorage.setItem("rigctl-token", found);
      history.replaceState(null, "", location.pathname);
    }
    return sessionStorage.getItem("rigctl-token");
  } catch {
    return found; // a browser that keeps nothing: the token stays in the address
  }
}

export class Commands {
  constructor() {
    this.token = takeToken();
    this.waiting = null;
    this.mine = false;
    byId("hold").addEventListener("click", () => this.give("hold"));
    byId("take").addEventListener("click", () => this.lease("take"));
    byId("return").addEventListener("click", () => this.lease("return"));
    byId("confirm-yes").addEventListener("click", () => this.confirm());
    byId("confirm-no").addEventListener("click", () => this.ask(null));
    for (const button of document.querySelectorAll("[data-verb]")) {
      button.addEventListener("click", () => this.give(button.dataset.verb));
    }
  }

  // Asked again whenever the server is a new one: a token is good for one start.
  async rights() {
    if (!this.token) return;
    const { ok, answer } = await this.post("rights", {});
    byId("commands").hidden = !ok;
    byId("rights").textContent = ok ? `commands as ${answer.operator}` : "read-only";
    byId("rights").title = ok ? "" : answer.text;
    byId("rights").classList.toggle("rights", ok);
    this.ask(null);
  }

  show(state) {
    const mine = (this.mine = Boolean(state.lease?.mine)), foreign = !mine && state.lease && !/^nobody/.test(state.lease.text);
    byId("take").hidden = mine;
    byId("take").textContent = foreign ? "take the lease over" : "take the lease";
    byId("reason").hidden = !foreign;
    byId("return").hidden = !mine;
    byId("verbs").hidden = !mine || Boolean(this.waiting);
    for (const button of document.querySelectorAll("[data-verb]")) button.disabled = !mine || state.stale;
  }

  async give(verb) {
    this.ask(null);
    const body = { verb };
    if (verb === "target") {
      body.value = byId("newtons").valueAsNumber;
      if (!Number.isFinite(body.value)) return this.say("TARGET: found no number of newtons", false);
    }
    const { ok, answer } = await this.post("command", body);
    if (ok && answer.confirm) this.ask(answer);
    else this.say(answer.text, ok);
  }

  async lease(act) {
    const { ok, answer } = await this.post("lease", { act, reason: act === "take" ? byId("reason").value.trim() : "" });
    if (ok) byId("reason").value = "";
    this.say(answer.text, ok);
  }

  ask(proposal) {
    clearTimeout(this.timer);
    this.waiting = proposal;
    byId("confirm").hidden = !proposal;
    byId("verbs").hidden = !this.mine || Boolean(proposal);
    if (!proposal) return;
    byId("confirm-text").textContent = `${proposal.text}?`;
    this.say("", true);
    this.timer = setTimeout(() => this.ask(null), proposal.for_s * 1000);
  }

  async confirm() {
    const proposal = this.waiting;
    if (!proposal) return;
    this.ask(null);
    this.say("...", true);
    const { ok, answer } = await this.post("confirm", { confirm: proposal.confirm });
    this.say(answer.text, ok);
  }

  async post(what, body) {
    const headers = { "content-type": "application/json", "x-rigctl-token": this.token };
    try {
      const reply = await fetch(`/api/${what}`, { method: "POST", headers, body: JSON.stringify(body) });
      return { ok: reply.ok, answer: await reply.json() };
    } catch {
      return { ok: false, answer: { text: "the page server does not answer: what became of it is not known" } };
    }
  }

  say(text, ok) {
    byId("said").textContent = text;
    byId("said").className = ok ? "" : "bad";
  }
}
