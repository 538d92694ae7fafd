// Browsers refuse workers to a page opened from disk. There the search runs in a hidden frame instead.
if (location.protocol === "file:") {
  window.Worker = class {
    constructor(url) {
      this.frame = document.createElement("iframe");
      this.frame.hidden = true;
      this.frame.srcdoc = `<script src="${url}"></script>`;
      this.ready = new Promise((resolve) => (this.frame.onload = resolve)).then(() => {
        this.frame.contentWindow.postMessage = (data) => {
          const copy = structuredClone(data);
          setTimeout(() => this.onmessage?.({ data: copy }));
        };
      });
      document.documentElement.append(this.frame);
    }
    postMessage(data) {
      const copy = structuredClone(data);
      this.ready.then(() => this.frame.contentWindow?.onmessage({ data: copy }));
    }
    terminate() {
      this.frame.remove();
    }
  };
}
