// Sign-in: a one-time link makes a session. Its cookie is the browser's, its key is stored for this page alone.
const KEY = "rigctl-key";

function kept() {
  try {
    return localStorage.getItem(KEY) ?? "";
  } catch {
    return ""; // a browser that keeps nothing: a reload needs another link
  }
}

export class Session {
  constructor() {
    this.key = kept();
    this.reads = true;
    this.signedIn = false;
    this.operator = null;
    this.text = this.refused = "";
    addEventListener("hashchange", () => location.reload()); // another link, pasted into this tab
  }

  // Exchanges the link in the address, if there is one, and takes it out of the history.
  async enter() {
    const link = new URLSearchParams(location.hash.slice(1)).get("link");
    if (link) {
      history.replaceState(null, "", location.pathname);
      const { ok, answer } = await this.post("sign-in", { link });
      if (ok) this.keep(answer.key);
      else this.refused = answer.text;
    }
    await this.look();
  }

  async look() {
    const { ok, answer } = await this.post("session", {});
    if (!ok) return;
    this.reads = answer.reads;
    this.signedIn = answer.signed_in;
    this.operator = answer.operator;
    this.text = (!this.signedIn && this.refused) || answer.text;
  }

  async leave() {
    await this.post("sign-out", {});
    this.keep("");
    location.reload();
  }

  keep(key) {
    this.key = key;
    try {
      localStorage.setItem(KEY, key);
    } catch {
      // see kept()
    }
  }

  get protocols() {
    return this.key ? ["rigctl", `rigctl.key.${this.key}`] : ["rigctl"];
  }

  // ``answer``: the response itself, null without one.
  async get(what) {
    try {
      const answer = await fetch(`/api/${what}`, { headers: this.key ? { "x-rigctl-key": this.key } : {} });
      return { ok: answer.ok, answer };
    } catch {
      return { ok: false, answer: null };
    }
  }

  async post(what, body) {
    const headers = { "content-type": "application/json" };
    if (this.key) headers["x-rigctl-key"] = this.key;
    try {
      const reply = await fetch(`/api/${what}`, { method: "POST", headers, body: JSON.stringify(body) });
      return { ok: reply.ok, answer: await reply.json() };
    } catch {
      return { ok: false, answer: { text: "the page server does not answer: what became of the request is not known" } };
    }
  }
}
