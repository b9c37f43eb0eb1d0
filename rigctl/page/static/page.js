// The live page: one websocket in, charts and words out. `window.rigctl` is for whoever looks into it.
import { AlarmTable } from "./alarms.js";
import { Bar } from "./bar.js";
import { Commands } from "./commands.js";
import { Histogram } from "./histogram.js";
import { History } from "./events.js";
import { Link } from "./link.js";
import { keep, kept, Theme } from "./look.js";
import { Mimic } from "./mimic.js";
import { Panel } from "./panel.js";
import { Polar } from "./polar.js";
import { Store } from "./store.js";
import { Runs } from "./runs.js";
import { Session } from "./session.js";
import { Strips } from "./strips.js";

const STALE_S = 1;
const STEP_PX = 0.4; // the charts are drawn again when they have moved by so much ...
const SHORTEST_MS = 22, LONGEST_MS = 500; // ... within these bounds
const POLAR_MS = 100;
const byId = (id) => document.getElementById(id);

const store = new Store(), session = new Session(), commands = new Commands(session), events = new History();
const alarms = new AlarmTable(session, (text, ok) => commands.say(text, ok));
const runs = new Runs(session, (text, ok) => commands.say(text, ok));
const panel = new Panel(new Bar(byId("bar")), new Mimic(document.querySelector("#mimic svg")), alarms);
const strips = new Strips(byId("strips"), store);
const polar = new Polar(document.querySelector("#polar canvas"), byId("polar-range"), store);
const histogram = new Histogram(document.querySelector("#lateness canvas"), byId("lateness-figures"));
let hello = null, state = null, heard = 0, names = [], windowsS = [60], firstDrawMs = null, drawn = 0, drawnFrames = -1, polarDrawn = 0;
let chosen = Number(kept("window") ?? 0);
if (!(chosen in [0, 1, 2, 3])) chosen = 0;

const theme = new Theme(byId("theme"), () => {
  strips.restyle();
  polar.restyle();
  histogram.restyle();
  drawn = polarDrawn = 0;
});

function take(data) {
  if (typeof data !== "string") return store.take(data, performance.now());
  const message = JSON.parse(data);
  if (message.kind === "hello") greet(message);
  else if (message.kind === "state") show(message);
  else if (message.kind === "events") {
    events.take(message.events);
    strips.events = events.marks;
    drawn = 0;
  }
  else if (message.kind === "lateness") histogram.take(message);
  else if (message.kind === "settings") {
    strips.settings = polar.settings = message;
    panel.settings = message;
    histogram.periodUs = message.period_us;
  }
}

function greet(message) {
  if (hello && hello.assets !== message.assets) return location.reload();
  if (!hello || hello.server !== message.server) commands.rights();
  hello = message;
  names = message.signals;
  strips.shown = message.strips;
  windowsS = message.windows_s;
  histogram.edges = message.edges_us;
  store.clear();
  const buttons = windowsS.map((seconds, i) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = seconds < 3600 ? (seconds <= 60 ? `${seconds} s` : `${seconds / 60} min`) : `${seconds / 3600} h`;
    button.setAttribute("aria-pressed", String(i === chosen));
    button.addEventListener("click", () => choose(i));
    return button;
  });
  byId("windows").replaceChildren(...buttons);
}

// The span shown; the charts follow the newest data again.
function choose(window) {
  chosen = window;
  keep("window", window);
  strips.follow();
  link.choose(window);
  drawn = 0;
  [...byId("windows").children].forEach((button, i) => button.setAttribute("aria-pressed", String(i === window)));
}

function see(view) {
  document.querySelector("main").dataset.view = view;
  for (const area of document.querySelectorAll("main > section")) area.hidden = !area.classList.contains(`of-${view}`);
  for (const button of byId("views").querySelectorAll("button")) button.setAttribute("aria-pressed", String(button.dataset.view === view));
  if (view === "runs") runs.load();
  strips.resize();
  alarms.count();
  histogram.draw();
  polarDrawn = drawn = 0;
  panel.fit();
  alarms.count();
}

function show(message) {
  state = message;
  heard = performance.now();
  panel.operator = session.operator;
  panel.show(state);
  commands.show(state);
  if (state.values && !strips.paused) strips.title(state.values, typeof state.values.error_n === "number" && !state.ramping, state.doubts ?? {}, state.mode);
  panel.fit();
  look();
}

// Age of what is shown, whoever is to blame: loop, gateway, page server, or the way here.
function ageS() {
  if (!state || state.silent_s === null) return Infinity;
  return (performance.now() - heard) / 1000 + state.silent_s + (state.age_ms ?? 0) / 1000;
}

// Who is silent: the first on the way from here to the rig of whom most of the age comes.
function blame() {
  if (!session.reads) return session.text;
  if (!state) return "connecting";
  if (performance.now() - heard > 500 * STALE_S) return `the page server at ${location.host} does not answer; reconnecting`;
  if (state.silent_s === null || state.silent_s > 0.5 * STALE_S) return state.trouble;
  return state.why || "the loop writes no records";
}

// The age shown is that of the newest record, and of the device whose sample is old; without data at all the
// instructions stay, the measurements go grey.
function look() {
  const age = ageS(), stale = age > STALE_S, device = age + (state?.oldest?.age_ms ?? 0) / 1000;
  set("age", Number.isFinite(age) ? `${seconds(age)} s old${device > age + STALE_S ? `, ${state.oldest.name} ${seconds(device)} s` : ""}` : "-");
  document.body.classList.toggle("stale", stale);
  byId("entry-box").classList.toggle("unknown", stale);
  if (!stale) return;
  const known = Number.isFinite(age), silent = performance.now() - heard > 500 * STALE_S;
  set("stale-what", known ? `NO DATA FOR ${Math.floor(age)} s` : session.reads ? "NO DATA" : "SIGN IN");
  const hold = silent ? "HOLD from this page does not arrive: use the emergency stop, or rigctl hold at the rig's computer." : state?.hold ?? "";
  set("stale-why", [`${blame()}.`, known ? "The measurements shown are old." : "", known ? hold : ""].filter(Boolean).join(" "));
  set("entry", "KEEP OUT");
  set("entry-why", "what the rig does is not known");
  byId("entry-box").dataset.entry = "KEEP OUT";
  byId("entry-box").classList.remove("unheld");
  if (!session.reads) return panel.steps([{ text: "Open a link of rigctl page (rigctl page --link prints one).", verb: "" }]);
  panel.steps([
    { text: "Keep out of the hall.", verb: "" },
    { text: state?.flag_names?.includes("brake_fails") ? "If the load moves: support the payload from below, the brake does not hold it." : "If the load moves: press the emergency stop.", verb: "" },
    { text: silent ? "At the rig's computer: rigctl status; start the page anew." : state?.waits_for ? `Wait: the loop is started anew, and waits for: ${state.waits_for}.` : "At the rig's computer: rigctl doctor; start the daemon anew.", verb: "" },
  ]);
  panel.fit();
}

const seconds = (value) => value.toFixed(value < 10 ? 1 : 0);

function set(id, text) {
  if (byId(id).textContent !== text) byId(id).textContent = text;
}

function animate() {
  requestAnimationFrame(animate);
  const now = performance.now(), windowS = windowsS[chosen];
  if (store.newest < 0 || windowS === undefined) return;
  const level = strips.levelFor(windowsS, chosen, store.edge(now) / 1000);
  if (level !== link.window) link.choose(level); // older data than those at hand come in wider buckets
  const moving = (STEP_PX * 1000 * windowS) / Math.max(300, strips.root.clientWidth);
  const stepMs = Math.min(Math.max(SHORTEST_MS, moving), LONGEST_MS);
  const resting = now - heard > 1000 && store.frames === drawnFrames;
  if (now - drawn < stepMs || ((resting || strips.settled) && drawn)) return;
  drawn = Math.max(drawn + stepMs, now - stepMs); // on average so often, whatever the screen's own rate
  drawnFrames = store.frames;
  strips.draw(store.edge(now) / 1000, windowS, names);
  if (now - polarDrawn >= POLAR_MS) {
    polarDrawn = now;
    polar.draw(names);
  }
  firstDrawMs ??= performance.now();
}

await session.enter();
const link = new Link(take, session, () => commands.rights(), chosen);
strips.onView = () => (drawn = 0);
strips.tools();
for (const button of byId("views").querySelectorAll("button")) button.addEventListener("click", () => see(button.dataset.view));
see("rig");
matchMedia("(max-width: 1200px)").addEventListener("change", ({ matches }) => !matches && document.querySelector("main").dataset.view === "drawing" && see("rig"));
setInterval(look, 200);
requestAnimationFrame(animate);

window.rigctl = {
  store, strips, link, choose, theme, see, commands, events,
  get state() { return state; },
  get stale() { return document.body.classList.contains("stale"); },
  get draws() { return strips.draws; },
  get firstDrawMs() { return firstDrawMs; },
  signal: (name) => names.indexOf(name),
};
