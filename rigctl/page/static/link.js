// The websocket: opened again whenever it ends, soon at first, then every two seconds.
const FIRST_MS = 250, LONGEST_MS = 2000, SILENT_MS = 4000;

export class Link {
  constructor(take, session, refused, window = 0) {
    this.take = take;
    this.session = session;
    this.refused = refused;
    this.window = window;
    this.connected = false;
    this.opened = 0;
    this.waitMs = FIRST_MS;
    this.open();
    setInterval(() => this.look(), 1000);
  }

  open() {
    this.heard = performance.now();
    const address = `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/stream`;
    const socket = (this.socket = new WebSocket(address, this.session.protocols));
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.connected = true;
      this.heard = performance.now(); // opening may have taken long, as while the server starts
      this.opened++;
      this.waitMs = FIRST_MS;
      this.choose(this.window);
    };
    socket.onmessage = (message) => {
      this.heard = performance.now();
      this.take(message.data);
    };
    socket.onclose = () => {
      if (socket !== this.socket) return;
      this.connected = false;
      this.refused(); // perhaps: a browser says no more than that it has ended
      setTimeout(() => this.open(), this.waitMs);
      this.waitMs = Math.min(2 * this.waitMs, LONGEST_MS);
    };
  }

  // A connection over which nothing comes (the other computer was switched off) never says that it has ended.
  look() {
    if (this.connected && performance.now() - this.heard > SILENT_MS) this.socket.close();
  }

  choose(window) {
    this.window = window;
    if (this.connected) this.socket.send(JSON.stringify({ window }));
  }
}
