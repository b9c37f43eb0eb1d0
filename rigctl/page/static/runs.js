// Recorded runs and trip dumps, what is made of them, and notes for the record of the running one.
const byId = (id) => document.getElementById(id);
const FILES = { report: "report.html", csv: "tables.zip", picture: "overview.svg" };

export class Runs {
  constructor(session, say) {
    this.session = session;
    this.say = say;
    byId("note").addEventListener("submit", (event) => {
      event.preventDefault();
      this.note();
    });
    byId("run-table").addEventListener("click", ({ target }) => target.dataset.run && this.fetch(target.dataset.run, target.dataset.file));
  }

  async load() {
    byId("note").hidden = !this.session.operator;
    this.tell("reading ...");
    const { ok, answer } = await this.session.get("runs");
    if (!ok) return this.tell((await this.textOf(answer)) || "the page server does not answer");
    const { runs } = await answer.json();
    this.tell(runs.length ? "" : "nothing is recorded");
    byId("run-table").tBodies[0].replaceChildren(...runs.map((run) => this.row(run)));
  }

  row(run) {
    const tr = document.createElement("tr"), buttons = document.createElement("td");
    const words = [run.name || "-", new Date(1000 * run.began_s).toLocaleString([], { hour12: false }), duration(run.duration_s), run.fault ?? (run.trips.join(", ") || "no trip"), run.notes.join("; ")];
    tr.append(...words.map((text) => Object.assign(document.createElement("td"), { textContent: text })), buttons);
    for (const file of run.name ? Object.keys(FILES) : []) {
      const button = Object.assign(document.createElement("button"), { type: "button", textContent: file });
      button.setAttribute("aria-label", `${file} of ${run.name}`);
      Object.assign(button.dataset, { run: run.name, file });
      buttons.append(button);
    }
    return tr;
  }

  async fetch(run, file) {
    this.tell(`${file} of ${run} is being made, at the lowest priority ...`);
    const { ok, answer } = await this.session.get(`runs/${run}/${file}`);
    if (!ok) return this.tell((await this.textOf(answer)) || "the page server does not answer");
    const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(await answer.blob()), download: `${run}-${FILES[file]}` });
    link.click();
    URL.revokeObjectURL(link.href);
    this.tell(`${link.download} is downloaded`);
  }

  async note() {
    const { ok, answer } = await this.session.post("note", { text: byId("note-text").value });
    this.say(answer.text, ok);
    this.tell(answer.text);
    if (!ok) return;
    byId("note-text").value = "";
    this.load();
  }

  async textOf(answer) {
    try {
      return (await answer.json()).text;
    } catch {
      return "";
    }
  }

  tell(text) {
    byId("runs-said").textContent = text;
  }
}

const duration = (s) => (s < 120 ? `${Math.round(s)} s` : s < 7200 ? `${Math.round(s / 60)} min` : `${(s / 3600).toFixed(1)} h`);
