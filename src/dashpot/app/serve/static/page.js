// Uploads, drops and clicks in drawings: what a browser must do itself.  TOKEN and MOST are set by the page.
(() => {
  // The page is shown when it is built and its styles are there; until then #first stands in its place.
  const first = document.getElementById("first"), styles = document.getElementById("styles");
  if (matchMedia("(prefers-color-scheme: dark)").matches) document.body.classList.add("body--dark");
  const ready = () => {
    if ((styles && styles.media !== "all") || !document.querySelector("#app header")) return;
    built.disconnect();
    first.remove();
  };
  const built = new MutationObserver(ready);
  built.observe(document.documentElement, { childList: true, subtree: true, attributeFilter: ["media"] });
  const say = text => { const at = document.getElementById("moved"); if (at) at.textContent = text; };
  const size = bytes => bytes > 1e9 ? (bytes / 2 ** 30).toFixed(2) + " GB" : (bytes / 2 ** 20).toFixed(1) + " MB";
  let waiting = [], running = null;
  function next() {
    running = waiting.shift() || null;
    if (!running) { setTimeout(() => say(""), 1500); return; }
    const { file, kind } = running, request = new XMLHttpRequest();
    const began = Date.now();
    request.open("POST", `/upload?kind=${kind}&name=${encodeURIComponent(file.name)}&token=${encodeURIComponent(TOKEN)}`);
    request.upload.onprogress = event => {
      const share = event.loaded / Math.max(event.total, 1), left = (Date.now() - began) / 1000 * (1 / share - 1);
      say(`${file.name}: ${Math.round(100 * share)} % of ${size(event.total)}` + (left > 2 ? `, about ${Math.round(left)} s left` : ""));
    };
    request.onload = () => { say(request.status === 200 ? `${file.name}: taken` : ""); next(); };
    request.onerror = () => { say(`${file.name}: was not taken`); next(); };
    if (file.size > MOST) emitEvent("refused", `${file.name}: files of at most ${size(MOST)} are taken`), next();
    else request.send(file);
  }
  function take(files, kind) {
    for (const file of files) waiting.push({ file, kind });
    if (!running) next();
  }
  document.addEventListener("change", event => {
    const input = event.target;
    if (!(input instanceof HTMLInputElement) || !input.dataset.kind) return;
    take([...input.files], input.dataset.kind);
    input.value = "";
  });
  document.addEventListener("dragover", event => { event.preventDefault(); document.body.classList.add("dragging"); });
  document.addEventListener("dragleave", event => { if (!event.relatedTarget) document.body.classList.remove("dragging"); });
  document.addEventListener("drop", event => {
    event.preventDefault();
    document.body.classList.remove("dragging");
    if (event.dataTransfer && event.dataTransfer.files.length) take([...event.dataTransfer.files], "drop");
  });
  document.addEventListener("click", event => {
    const within = selector => event.target.closest && event.target.closest(selector);
    const drawing = within(".parts svg");
    if (drawing) emitEvent("part", near(drawing, event.clientX, event.clientY));
    const form = within("[data-section]");
    if (form) emitEvent("form", [form.dataset.section, form.dataset.name]);
    const line = within("[data-line]");
    if (line) show(Number(line.dataset.line));
    if (within("[data-new]"))
      fetch(`/new?token=${encodeURIComponent(TOKEN)}`, { method: "POST" }).then(answer => answer.json())
        .then(made => window.open(`/?token=${encodeURIComponent(made.token)}`, "_blank"));
    const copied = within("[data-copy]");
    if (copied) {
      copy(copied.dataset.copy);
      copied.textContent = "Copied";
      setTimeout(() => { copied.textContent = "Copy"; }, 1500);
    }
  });
  document.addEventListener("keydown", event => {
    if (event.key === "Enter" && event.ctrlKey) emitEvent("identify", "");
  });
  // What is shown anew keeps the keyboard's place: the element of the same name is focused again.
  let last = null;
  const name = node => (node.getAttribute("aria-label") || node.innerText || "").trim();
  document.addEventListener("focusin", event => { last = { node: event.target, name: name(event.target) }; });
  new MutationObserver(() => {
    if (!last || last.node.isConnected || !last.name || document.activeElement !== document.body) return;
    const same = [...document.querySelectorAll("button, input, textarea, [tabindex]")].find(node => name(node) === last.name);
    last = null;
    if (same) same.focus();
  }).observe(document.documentElement, { childList: true, subtree: true });
  // The texts of a drawing beside a point, the nearest first: a symbol means what is written next to it.
  function near(drawing, x, y) {
    const off = ({ left, right, top, bottom }) => Math.hypot(Math.max(left - x, x - right, 0), Math.max(top - y, y - bottom, 0));
    return [...drawing.querySelectorAll("text")].map(text => [off(text.getBoundingClientRect()), text.textContent])
      .filter(([far]) => far < 40).sort(([a], [b]) => a - b).map(([, text]) => text);
  }
  function copy(text) {
    if (navigator.clipboard) { navigator.clipboard.writeText(text); return; }
    const area = document.createElement("textarea");
    area.value = text; document.body.append(area); area.select(); document.execCommand("copy"); area.remove();
  }
  function show(line) {
    const area = document.querySelector(".mono textarea");
    if (!area) return;
    const lines = area.value.split("\n"), begin = lines.slice(0, line - 1).join("\n").length + (line > 1 ? 1 : 0);
    area.focus();
    area.setSelectionRange(begin, begin + (lines[line - 1] || "").length);
    area.scrollTop = Math.max(0, (line - 4) * 19.5);
  }
})();
