// The socket to the server. It is opened again whenever it closes; a page that was saved as a file has none.
const LONGEST_PAUSE_MS = 4000, FIRST_PAUSE_MS = 250;

export class Connection {
  /** @param take gets the frames of each message @param changed is told when the server comes or goes */
  constructor(take, changed) {
    Object.assign(this, { take, changed, socket: null, isOpen: false, pause: FIRST_PAUSE_MS });
  }

  open() {
    const saved = document.getElementById("saved");
    if (saved) {
      this.isOpen = true;
      this.take(JSON.parse(saved.textContent));
      return;
    }
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    this.socket = new WebSocket(new URL("live", `${scheme}://${location.host}${location.pathname}`));
    this.socket.onopen = () => {
      this.isOpen = true;
      this.pause = FIRST_PAUSE_MS;
    };
    this.socket.onmessage = async ({ data }) => {
      await this.take(JSON.parse(data));
      this.send({ type: "drawn" });
    };
    this.socket.onclose = () => {
      this.isOpen = false;
      this.changed();
      setTimeout(() => this.open(), this.pause);
      this.pause = Math.min(2 * this.pause, LONGEST_PAUSE_MS);
    };
  }

  send(message) {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }
}
