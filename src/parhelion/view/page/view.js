// The page of `parhelion view`, and the widget of notebooks: one picture, and what changes it.
//
// The interface (class View) knows two things of what carries its messages: `send(message)`, and
// that `receive(header, bytes)` and `connection(isThere)` are called. Below are two carriers, a
// WebSocket and a widget's model; parhelion/view/messages.py says what the messages are.

// --- Carriers ------------------------------------------------------------------------------------

// Milliseconds until a lost connection is tried again: the first time, and at most.
const FIRST_RETRY = 400;
const LONGEST_RETRY = 5000;

/** A connection that is made again whenever it is lost. */
class Socket {
  constructor(url) {
    this.url = url;
    this.retry = FIRST_RETRY;
    this.ended = false;
  }

  open(view) {
    this.view = view;
    const socket = new WebSocket(this.url);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.retry = FIRST_RETRY;
      this.socket = socket;
      view.connection(true);
    };
    socket.onmessage = ({ data }) => {
      const length = new DataView(data).getUint32(0, true);
      const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
      view.receive(header, new Uint8Array(data, 4 + length));
    };
    socket.onclose = () => {
      this.socket = null;
      if (this.ended) return;
      view.connection(false);
      this.timer = setTimeout(() => this.open(view), this.retry);
      this.retry = Math.min(2 * this.retry, LONGEST_RETRY);
    };
  }

  send(message) {
    this.socket?.send(JSON.stringify(message));
  }

  close() {
    this.ended = true;
    clearTimeout(this.timer);
    this.socket?.close();
  }
}

/** The model of an anywidget. */
class Model {
  constructor(model) {
    this.model = model;
  }

  open(view) {
    this.listener = (header, buffers) => {
      const bytes = buffers?.[0];
      view.receive(
        header,
        bytes ? new Uint8Array(bytes.buffer, bytes.byteOffset, bytes.byteLength) : new Uint8Array(),
      );
    };
    this.model.on("msg:custom", this.listener);
    view.connection(true);
    this.send({ type: "hello" });
  }

  send(message) {
    this.model.send(message);
  }

  close() {
    this.model.off("msg:custom", this.listener);
    this.send({ type: "goodbye" });
  }
}

// --- Vectors and cameras -------------------------------------------------------------------------

const add = (a, b, k = 1) => a.map((x, i) => x + k * b[i]);
const sub = (a, b) => a.map((x, i) => x - b[i]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];
const length = (a) => Math.hypot(...a);
const unit = (a) => a.map((x) => x / (length(a) || 1));
const RAD = Math.PI / 180;

/** `v` turned about the unit vector `axis` by an angle (Rodrigues' formula). */
function turned(v, axis, angle) {
  const c = Math.cos(angle);
  const s = Math.sin(angle);
  const out = add(v.map((x) => c * x), cross(axis, v), s);
  return add(out, axis, (1 - c) * dot(axis, v));
}

/** Unit vectors ahead, to the right and up in the picture. */
function frame(camera) {
  const ahead = unit(sub(camera.target, camera.eye));
  const right = unit(cross(ahead, camera.up));
  return { ahead, right, up: cross(right, ahead) };
}

// How near to straight up or down a camera that is turned may look.
const STEEPEST = 1 * RAD;

function orbited(camera, around, over) {
  const axis = unit(camera.up);
  let away = turned(sub(camera.eye, camera.target), axis, -around);
  const slope = Math.acos(Math.max(-1, Math.min(1, dot(unit(away), axis))));
  const wanted = Math.max(STEEPEST, Math.min(Math.PI - STEEPEST, slope - over));
  const side = unit(cross(axis, away));
  if (length(cross(axis, unit(away))) > 1e-4) away = turned(away, side, wanted - slope);
  return { ...camera, eye: add(camera.target, away) };
}

function moved(camera, x, y, z) {
  const f = frame(camera);
  let step = add(f.right.map((v) => v * x), f.up, y);
  step = add(step, f.ahead, z);
  return { ...camera, eye: add(camera.eye, step), target: add(camera.target, step) };
}

function dollied(camera, factor) {
  if (camera.projection === "orthographic") {
    const tall = camera.height ?? 2 * length(sub(camera.eye, camera.target));
    return { ...camera, height: tall * factor };
  }
  const away = sub(camera.eye, camera.target);
  return { ...camera, eye: add(camera.target, away, factor) };
}

/** Scene units that the picture is high at the target. */
function tall(camera, aspect) {
  if (camera.projection === "orthographic" && camera.height) return camera.height;
  const distance = length(sub(camera.eye, camera.target));
  let half = Math.tan((0.5 * (camera.vfov ?? 40) * RAD) % (Math.PI / 2));
  if (camera.fov != null) half = Math.tan((0.5 * camera.fov * RAD) % (Math.PI / 2)) / aspect;
  return 2 * distance * Math.max(half, 1e-3);
}

const CAMERA_DEFAULTS = {
  fov: null,
  vfov: null,
  aperture_radius: 0,
  focus_distance: null,
  projection: "perspective",
  height: null,
  shift: [0, 0],
  mirrored: false,
};

/** What differs from a camera's defaults; eye, target and up always. */
function essential(camera) {
  const same = (a, b) => JSON.stringify(a) === JSON.stringify(b);
  return Object.fromEntries(
    Object.entries(camera).filter(([key, value]) => !same(value, CAMERA_DEFAULTS[key])),
  );
}

const asJson = (camera) => JSON.stringify({ camera: essential(camera) });

function asPython(camera) {
  const said = (v) =>
    Array.isArray(v) ? `(${v.map(said).join(", ")})`
    : v === true ? "True"
    : typeof v === "string" ? JSON.stringify(v)
    : String(v);
  const lines = Object.entries(essential(camera)).map(([key, v]) => `    ${key}=${said(v)},`);
  return `ph.Camera(\n${lines.join("\n")}\n)`;
}

// --- Colours and numbers -------------------------------------------------------------------------

const toSrgb = (x) => (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055);
const toLinear = (x) => (x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4);
const toHex = (rgb) =>
  "#" +
  rgb
    .map((x) => Math.round(255 * toSrgb(Math.max(0, Math.min(1, x)))))
    .map((x) => x.toString(16).padStart(2, "0"))
    .join("");
const fromHex = (hex) =>
  [1, 3, 5].map((i) => Number(toLinear(parseInt(hex.slice(i, i + 2), 16) / 255).toPrecision(4)));

function short(x, digits = 3) {
  if (x === 0 || x == null) return "0";
  const size = Math.abs(x);
  return size >= 1e5 || size < 1e-3 ? x.toExponential(digits - 1) : String(+x.toPrecision(digits));
}

function counted(n) {
  for (const [size, word] of [[1e9, "G"], [1e5, "M"], [1e4, "k"]]) {
    const unit = word === "M" ? 1e6 : word === "k" ? 1e3 : size;
    if (n >= size) return `${(n / unit).toFixed(n / unit < 10 ? 2 : 1)} ${word}`;
  }
  return String(Math.round(n));
}

const bytes = (n) => (n == null ? "" : n < 1e9 ? `${Math.round(n / 1e6)} MB` : `${(n / 1e9).toFixed(1)} GB`);

function clock(seconds) {
  const s = Math.floor(seconds);
  const two = (x) => String(x).padStart(2, "0");
  return s < 3600
    ? `${Math.floor(s / 60)}:${two(s % 60)}`
    : `${Math.floor(s / 3600)}:${two(Math.floor(s / 60) % 60)}:${two(s % 60)}`;
}

const plainly = (name) =>
  name
    .replaceAll("_", " ")
    .replace(/\bior\b/, "IOR")
    .replace(/^./, (c) => c.toUpperCase());

// --- Elements ------------------------------------------------------------------------------------

/** An element; of properties, those that begin with "on" are listeners, the rest attributes. */
function h(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [key, value] of Object.entries(properties)) {
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else if (value === true) element.setAttribute(key, "");
    else if (value !== false && value != null) element.setAttribute(key, value);
  }
  element.append(...children.filter((c) => c != null));
  return element;
}

const PATHS = {
  pause: '<path d="M7 4.500v11M13 4.500v11"/>',
  play: '<path d="M6 4l10 6-10 6z"/>',
  save: '<path d="M10 3v9m0 0 3.500-3.500M10 12 6.500 8.500M4 15.500h12"/>',
  camera: '<path d="M3 6.500h3l1.500-2h5l1.500 2h3v9H3z"/><circle cx="10" cy="10.700" r="2.700"/>',
  panel: '<path d="M3 4h14v12H3zM12.500 4v12"/>',
  help: '<path d="M7.500 7.600A2.600 2.600 0 1 1 10 11v1.300"/><path d="M10 15.200v.1"/>',
  theme: '<path d="M16 11.600A6.500 6.500 0 1 1 8.400 4a5.200 5.200 0 0 0 7.600 7.600z"/>',
  orbit: '<circle cx="10" cy="10" r="1.600"/><path d="M16.300 8.200A6.600 6.600 0 1 0 16.300 12"/><path d="M17 4.300v4.100h-4.100"/>',
  focus: '<path d="M3.500 7V3.500H7M13 3.500h3.500V7M16.500 13v3.500H13M7 16.500H3.500V13"/><circle cx="10" cy="10" r="2"/>',
  crop: '<path d="M6 2.500V14h11.500M2.500 6H14v11.500"/>',
  home: '<path d="M3.500 9.500 10 4l6.500 5.500M5.500 8.500V16h9V8.500"/>',
  plus: '<path d="M10 4.500v11M4.500 10h11"/>',
  minus: '<path d="M4.500 10h11"/>',
  eye: '<path d="M2.500 10S5.200 5.300 10 5.300 17.500 10 17.500 10 14.800 14.700 10 14.700 2.500 10 2.500 10z"/><circle cx="10" cy="10" r="2.100"/>',
  hidden: '<path d="M3 10s1 1.700 2.900 3M17 10s-2.300 4.700-7 4.700M10 5.300c4.700 0 7 4.700 7 4.700M3 10s1.900-3.800 5.400-4.600M4 4l12 12"/>',
  close: '<path d="M5 5l10 10M15 5 5 15"/>',
};

function icon(name) {
  const holder = document.createElement("template");
  holder.innerHTML = `<svg class="ph-icon" viewBox="0 0 20 20" aria-hidden="true">${PATHS[name]}</svg>`;
  return holder.content.firstChild;
}

function button(name, label, onclick, more = {}) {
  return h("button", { type: "button", class: "ph-button", "aria-label": label, title: label, onclick, ...more }, icon(name));
}

const LOGO =
  '<svg class="ph-logo" viewBox="0 0 32 32" aria-hidden="true"><circle cx="16" cy="16" r="5.500" fill="currentColor"/><path d="M4 22a13 13 0 0 1 0-12M28 22a13 13 0 0 0 0-12" fill="none" stroke="currentColor" stroke-width="2.600" stroke-linecap="round"/></svg>';

// Keys that move a slider
const MOVES = new Set(["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "Home", "End", "PageUp", "PageDown"]);

// What a number's field shows when it is left without one
function remember(field) {
  field.addEventListener("focus", () => (field.dataset.before = field.value));
}

// The number of a field, or null where there is none: what was there before is shown again.
function entered(field) {
  const value = field.value.trim() === "" ? NaN : Number(field.value);
  if (Number.isFinite(value)) return value;
  field.value = field.dataset.before ?? "";
  return null;
}

const HELP = [
  ["Turn", "Drag", "One finger", "Arrow keys"],
  ["Move sideways", "Right button, or Shift and drag", "Two fingers", "Shift and arrow keys"],
  ["Nearer, farther", "Wheel", "Pinch", "+ and -"],
  ["Walk", "", "", "W A S D, Q and E"],
  ["Field of view", "Alt and wheel", "Panel", "[ and ]"],
  ["What is it?", "Rest, or click", "Tap", ""],
  ["Turn about a place", "Double click", "Double tap", ""],
  ["Focus on a place", "Focus tool, click", "Focus tool, tap", "F, then click"],
  ["Render a part", "Crop tool, drag", "Crop tool, drag", "C, then drag"],
  ["First camera", "Home", "Home", "H"],
  ["Pause, go on", "Pause", "Pause", "Space"],
  ["Darker, brighter", "Slider", "Slider", ", and ."],
  ["Next layer", "List", "List", "L"],
  ["Save PNG, EXR", "Save", "Save", "Ctrl S, Ctrl Shift S"],
  ["Copy the camera", "Camera", "Camera", "J for JSON, P for Python"],
  ["Panel, this help", "", "", "T, ?"],
];

const TRANSFORMS = { srgb: "sRGB, cut at white", agx: "AgX", aces: "ACES 2.0", "aces-1.3": "ACES 1.3" };

// Of very many objects and materials so many are listed; the filter finds the others.
const MOST_LISTED = 200;
// Milliseconds for which the pointer rests before it is said what is there.
const REST = 140;
// Milliseconds in which a camera that was sent comes back, if no other page's came between.
const PATIENCE = 1000;
// Pixels that a click may move, milliseconds between the two of a double one.
const STILL = 5;
const DOUBLE = 320;

// --- The interface -------------------------------------------------------------------------------

class View {
  constructor(root, carrier, options = {}) {
    this.root = root;
    this.carrier = carrier;
    this.options = options;
    this.state = null;
    this.outline = null;
    this.camera = null;
    // of cameras that were sent; other pages of the same session begin elsewhere
    this.stamp = Math.floor(Math.random() * 2 ** 30);
    this.sent = null; // the newest of which no state has come back yet, and when it was sent
    this.arrived = this.drawn = 0; // frames so far, and which of them was drawn last
    this.tool = "orbit";
    this.pointers = new Map();
    this.requests = new Map();
    this.request = 0;
    this.material = 0;
    this.light = 0;
    this.filter = "";
    this.fill = null;
    this.detail = 1;
    this.held = null; // the control that is being moved: not to be written over
    this.build();
    this.ends = new AbortController();
    this.listen();
    carrier.open(this);
  }

  close() {
    this.ends.abort();
    this.observer.disconnect();
    this.carrier.close();
    this.root.replaceChildren();
  }

  send(type, message = {}) {
    this.carrier.send({ type, ...message });
  }

  // What an answer comes to
  ask(type, message) {
    const id = ++this.request;
    this.send(type, { ...message, id });
    return new Promise((resolve, reject) => this.requests.set(id, { resolve, reject }));
  }

  // --- What is there

  build() {
    const root = this.root;
    root.classList.add("parhelion");
    root.classList.toggle("ph-in-page", !this.options.widget);
    root.replaceChildren();
    const theme = this.options.widget ? null : localStorage.getItem("parhelion-theme");
    if (theme) root.dataset.theme = theme;

    this.title = h("span", { class: "ph-title" }, "");
    this.pauseButton = button("pause", "Pause", () => this.pause());
    const brand = h("div", { class: "ph-brand" }, h("strong", {}, "Parhelion"), this.title);
    brand.insertAdjacentHTML("afterbegin", LOGO);
    const bar = h(
      "header",
      { class: "ph-bar" },
      brand,
      h(
        "div",
        { class: "ph-actions", role: "toolbar", "aria-label": "Picture" },
        this.pauseButton,
        this.menu("save", "Save the picture", [
          ["PNG, as shown", () => this.save("png")],
          ["EXR, linear light", () => this.save("exr")],
          ["JSON, the scene", () => this.save("json")],
        ]),
        this.menu("camera", "Copy the camera", [
          ["As JSON", () => this.copy("json")],
          ["As Python", () => this.copy("python")],
        ]),
        this.options.widget ? null : button("theme", "Light or dark", () => this.theme()),
        (this.panelButton = button("panel", "Panel", () => this.togglePanel(), { "aria-pressed": "true" })),
        button("help", "Keys and gestures", () => this.help.showModal()),
      ),
    );

    this.canvas = h("canvas", { width: 16, height: 9, "aria-hidden": "true" });
    this.cropBox = h("div", { class: "ph-crop", hidden: true });
    this.mark = h("div", { class: "ph-mark", hidden: true });
    this.picture = h("div", { class: "ph-picture", hidden: true }, this.canvas, this.cropBox, this.mark);
    this.tip = h("div", { class: "ph-tip", role: "status", hidden: true });
    this.waiting = h("div", { class: "ph-waiting" }, h("div", { class: "ph-spinner" }), h("span", {}, "Waiting for the first picture"));
    this.notice = h("div", { class: "ph-notice", role: "alert", hidden: true });
    this.toolButtons = Object.fromEntries(
      [
        ["orbit", "Turn (Esc)"],
        ["focus", "Focus on a place (F)"],
        ["crop", "Render a part only (C)"],
      ].map(([name, label]) => [name, button(name, label, () => this.choose(name), { "aria-pressed": "false" })]),
    );
    const tools = h(
      "div",
      { class: "ph-tools", role: "toolbar", "aria-label": "Tools", "aria-orientation": "vertical" },
      ...Object.values(this.toolButtons),
      h("hr"),
      button("plus", "Nearer (+)", () => this.dolly(0.8)),
      button("minus", "Farther (-)", () => this.dolly(1.25)),
      button("home", "First camera (H)", () => this.goHome()),
    );
    this.stage = h(
      "div",
      {
        class: "ph-stage",
        tabindex: "0",
        role: "application",
        "aria-label": "Picture. Arrow keys turn the camera; press ? for all keys.",
      },
      this.picture,
      this.waiting,
      this.tip,
    );

    this.status = h("footer", { class: "ph-status" });
    this.light_ = h("span", { class: "ph-dot", "aria-hidden": "true" });
    this.figures = Object.fromEntries(
      ["what", "size", "spp", "noise", "rate", "memory", "time"].map((key) => [key, h("span", { class: `ph-figure ph-${key}` })]),
    );
    this.progress = h("div", { class: "ph-progress", role: "progressbar", "aria-label": "Samples", "aria-valuemin": "0", "aria-valuemax": "100" }, h("div"));
    this.status.append(this.progress, this.light_, ...Object.values(this.figures));

    this.panel = h("aside", { class: "ph-panel", "aria-label": "Settings" }, ...this.sections());
    this.live = h("div", { class: "ph-hidden", "aria-live": "polite" });
    this.toasts = h("div", { class: "ph-toasts", "aria-hidden": "true" });
    this.help = this.helpDialog();
    root.append(bar, h("div", { class: "ph-main" }, this.stage, tools, this.notice, this.toasts), this.panel, this.status, this.live, this.help);
    this.choose("orbit");
  }

  menu(name, label, entries) {
    const list = h("div", { class: "ph-menu", role: "menu", hidden: true });
    const opener = button(name, label, () => show(list.hidden), { "aria-haspopup": "menu", "aria-expanded": "false" });
    const holder = h("div", { class: "ph-holder" }, opener, list);
    const show = (open) => {
      list.hidden = !open;
      opener.setAttribute("aria-expanded", String(open));
      if (open) list.firstChild.focus();
    };
    for (const [text, action] of entries) {
      list.append(
        h("button", { type: "button", role: "menuitem", onclick: () => (show(false), opener.focus(), action()) }, text),
      );
    }
    holder.addEventListener("focusout", (e) => holder.contains(e.relatedTarget) || show(false));
    list.addEventListener("keydown", (e) => {
      const items = [...list.children];
      const at = items.indexOf(e.target);
      if (e.key === "Escape") (show(false), opener.focus());
      else if (e.key === "ArrowDown") items[(at + 1) % items.length].focus();
      else if (e.key === "ArrowUp") items[(at + items.length - 1) % items.length].focus();
      else return;
      e.preventDefault();
      e.stopPropagation();
    });
    return holder;
  }

  sections() {
    const section = (title, open, ...children) => h("details", { class: "ph-section", open }, h("summary", {}, title), h("div", { class: "ph-body" }, ...children));
    this.exposure = this.slider("Exposure", { low: -8, high: 8, step: 0.05, value: 0, unit: "EV" }, (v) => this.send("show", { exposure: v }));
    this.layer = h("select", { id: this.id(), onchange: () => this.send("show", { layer: this.layer.value }) });
    this.transform = h("select", { id: this.id(), onchange: () => this.send("show", { view_transform: this.transform.value }) });
    this.limit = h("input", { id: this.id(), type: "number", min: 1, max: 8388608, step: 1, onchange: () => this.limit.checkValidity() && this.send("limit", { spp: Number(this.limit.value) }) });
    this.detailList = h(
      "select",
      { id: this.id(), onchange: () => ((this.detail = Number(this.detailList.value)), this.fit(true)) },
      h("option", { value: 0.5 }, "Half"),
      h("option", { value: 1, selected: true }, "As the window"),
      h("option", { value: 2 }, "Double"),
    );
    this.fillBox = h("input", { id: this.id(), type: "checkbox", onchange: () => ((this.fill = this.fillBox.checked), this.fit(true)) });
    this.denoise = h("input", { id: this.id(), type: "checkbox", onchange: () => this.send("show", { denoise: this.denoise.checked }) });
    this.cropText = h("span", { class: "ph-value" }, "all");
    this.cropClear = h("button", { type: "button", class: "ph-small", onclick: () => this.crop(null), hidden: true }, "Render all");
    this.fov = this.slider("Field of view", { low: 1, high: 120, step: 0.1, value: 40, unit: "°" }, (v) => this.setFov(v));
    this.aperture = this.slider("Aperture", { low: 0, high: 1, step: 0, value: 0, unit: "" }, (v) => this.turn({ ...this.camera, aperture_radius: v }));
    this.focusText = h("span", { class: "ph-value" }, "");
    this.place = h("div", { class: "ph-card", "aria-live": "polite" }, h("p", { class: "ph-dim" }, "Click something in the picture."));
    this.objects = h("ul", { class: "ph-objects" });
    this.finder = h("input", { type: "search", placeholder: "Filter", "aria-label": "Filter objects", hidden: true, oninput: () => ((this.filter = this.finder.value), this.listObjects()) });
    this.materialList = h("select", { id: this.id(), onchange: () => ((this.material = Number(this.materialList.value)), this.listParameters("materials")) });
    this.lightList = h("select", { id: this.id(), onchange: () => ((this.light = Number(this.lightList.value)), this.listParameters("lights")) });
    this.parameters = { materials: h("div", { class: "ph-parameters" }), lights: h("div", { class: "ph-parameters" }) };
    this.restoreButton = h("button", { type: "button", class: "ph-small", onclick: () => ((this.held = null), this.send("restore")) }, "Restore materials and lights");
    const row = (label, control, ...more) => h("div", { class: "ph-row" }, h("label", control.id ? { for: control.id } : {}, label), control, ...more);
    this.materialSection = section("Material", true, row("Material", this.materialList), this.parameters.materials);
    this.lightSection = section("Lights", false, row("Light", this.lightList), this.parameters.lights);
    this.objectSection = section("Objects", true, this.finder, this.objects);
    return [
      section(
        "Picture",
        true,
        this.exposure.element,
        row("View transform", this.transform),
        (this.denoiseRow = row("Denoise", this.denoise)),
        row("Layer", this.layer),
        row("Most samples", this.limit),
        row("Resolution", this.detailList),
        row("Fill the window", this.fillBox),
        row("Part", this.cropText, this.cropClear),
      ),
      section("Camera", false, this.fov.element, this.aperture.element, row("Focus", this.focusText)),
      section("Selected", true, this.place),
      this.materialSection,
      this.lightSection,
      this.objectSection,
      h("div", { class: "ph-body" }, this.restoreButton),
    ];
  }

  helpDialog() {
    const head = ["", "Mouse", "Touch", "Keyboard"].map((t) => h("th", { scope: "col" }, t));
    const rows = HELP.map(([what, ...ways]) => h("tr", {}, h("th", { scope: "row" }, what), ...ways.map((w) => h("td", {}, w))));
    const dialog = h(
      "dialog",
      { class: "ph-help", "aria-label": "Keys and gestures" },
      h("div", { class: "ph-help-head" }, h("h2", {}, "Keys and gestures"), button("close", "Close", () => dialog.close())),
      h("div", { class: "ph-help-body" }, h("table", {}, h("thead", {}, h("tr", {}, ...head)), h("tbody", {}, ...rows))),
    );
    dialog.addEventListener("click", (e) => e.target === dialog && dialog.close());
    return dialog;
  }

  id() {
    return `ph-${Math.random().toString(36).slice(2, 9)}`;
  }

  // A range and a number that go together. step 0: any.
  slider(label, { low, high, step, value, unit = "", log = false }, changed) {
    const id = this.id();
    const to = (v) => (log ? Math.log10(Math.max(v, low)) : v);
    const from = (v) => (log ? 10 ** v : v);
    const any = step || "any";
    let top = to(high);
    const range = h("input", { id, type: "range", min: to(low), max: to(high), step: log ? "any" : any });
    const number = h("input", { type: "number", step: "any", "aria-label": `${label}, number` });
    const put = (v) => {
      if (!log) range.max = Math.max(top, v); // further only while a number is there
      if (!log) range.min = Math.min(low, v);
      range.value = to(v);
      number.value = short(v, 4);
      fill();
    };
    const fill = () => {
      const share = (range.value - range.min) / (range.max - range.min || 1);
      range.style.setProperty("--share", `${100 * share}%`);
    };
    const round = (v) => (step ? Math.round(v / step) * step : Number(v.toPrecision(4)));
    range.addEventListener("input", () => {
      this.hold(range);
      const v = round(from(Number(range.value)));
      number.value = short(v, 4);
      fill();
      changed(v);
    });
    number.addEventListener("change", () => {
      const v = entered(number);
      if (v === null) return;
      put(v);
      changed(v);
    });
    remember(number);
    put(value);
    const element = h("div", { class: "ph-row ph-slider" }, h("label", { for: id }, label), range, h("span", { class: "ph-unit" }, number, unit));
    return {
      element,
      range,
      number,
      set: (v) => this.held !== range && document.activeElement !== number && put(v),
      reach: (most) => ((range.max = top = to(most)), fill()),
    };
  }

  // A control that is moved is not written over by what the session told meanwhile.
  hold(control) {
    this.held = control;
    clearTimeout(this.letGo);
    this.letGo = setTimeout(() => (this.held = null), 600);
  }

  // --- What comes

  connection(there) {
    this.connected = there;
    this.root.classList.toggle("ph-lost", !there);
    if (there) {
      if (this.wasLost) this.say("Connected again");
      this.wasLost = false;
      this.sent = null;
      this.sized = null;
      if (this.state) this.fit(true);
    } else {
      this.wasLost = true;
      for (const { reject } of this.requests.values()) reject(new Error("the connection was lost"));
      this.requests.clear();
    }
    this.tellNotice();
    this.tellStatus();
  }

  receive(header, data) {
    if (header.type === "frame") this.onFrame(header, data);
    else if (header.type === "state") this.onState(header);
    else if (header.type === "scene") this.onScene(header);
    else if (header.type === "values") this.onValues(header);
    else if (header.type === "error") {
      if (this.answer(header.id, null, header.text)) return;
      this.say(header.text, true);
      for (const kind of ["materials", "lights"]) this.listParameters(kind); // as they still are
    } else this.answer(header.id, { ...header, data });
  }

  answer(id, value, error) {
    const waiting = this.requests.get(id);
    if (!waiting) return false;
    this.requests.delete(id);
    if (error) waiting.reject(new Error(error));
    else waiting.resolve(value);
    return true;
  }

  async onFrame(header, data) {
    const place = ++this.arrived;
    try {
      const bitmap = await createImageBitmap(new Blob([data], { type: header.mime }));
      // Unpacking may end in another order than frames came in; one picture comes again when it is
      // to be shown otherwise, so their numbers do not tell.
      if (place > this.drawn) this.draw(header, bitmap);
      this.drawn = Math.max(this.drawn, place);
      bitmap.close();
    } finally {
      this.send("seen", { frame: header.number });
    }
  }

  draw(header, bitmap) {
    this.frame = header;
    const { canvas } = this;
    const width = Math.round(header.width / header.scale);
    const height = Math.round(header.height / header.scale);
    const known = this.state && Math.abs(this.state.width - width) <= 2 + width * 0.02;
    const w = known ? this.state.width : width;
    const h_ = known ? this.state.height : height;
    if (canvas.width !== w || canvas.height !== h_) {
      const old = canvas.width > 16 ? canvas : null;
      const kept = old && new OffscreenCanvas(old.width, old.height);
      kept?.getContext("2d").drawImage(old, 0, 0);
      canvas.width = w;
      canvas.height = h_;
      if (kept) canvas.getContext("2d").drawImage(kept, 0, 0, w, h_);
    }
    const context = canvas.getContext("2d");
    context.imageSmoothingQuality = "high";
    const [x, y, fw, fh] = header.place;
    const kx = w / header.width;
    const ky = h_ / header.height;
    context.drawImage(bitmap, x * kx, y * ky, fw * kx, fh * ky);
    this.picture.hidden = false;
    this.waiting.hidden = true;
    this.root.dataset.frame = String(header.number);
    this.root.dataset.spp = String(header.spp);
    this.root.dataset.scale = String(header.scale);
    if (header.stamp !== null) this.root.dataset.stamp = String(header.stamp);
    this.layOut();
    this.tellStatus();
  }

  onState(state) {
    const first = this.state === null;
    const before = this.state;
    this.state = state;
    // states that are older than what was done here would turn the camera back
    if (this.sent?.stamp === state.stamp || performance.now() - this.sent?.time > PATIENCE) this.sent = null;
    if (this.sent === null && !this.turning) this.camera = state.camera;
    if (this.fill === null) {
      this.fill = state.aspect === null;
      this.fillBox.checked = this.fill;
    }
    this.title.textContent = state.scene;
    if (!this.options.widget) document.title = `${state.scene} - Parhelion`;
    this.exposure.set(state.exposure);
    this.denoise.checked = state.denoise;
    if (this.layer.options.length) this.layer.value = state.layer;
    if (this.transform.options.length) this.transform.value = state.view_transform;
    if (document.activeElement !== this.limit) this.limit.value = state.spp;
    this.pauseButton.replaceChildren(icon(state.paused ? "play" : "pause"));
    const label = state.paused ? "Go on" : "Pause";
    this.pauseButton.title = label;
    this.pauseButton.setAttribute("aria-label", `${label} (Space)`);
    this.root.dataset.paused = String(state.paused);
    this.tellCamera();
    this.tellCrop();
    this.tellNotice();
    this.tellStatus();
    if (first || before.width !== state.width || before.height !== state.height) this.layOut();
    if (first) this.fit(true);
  }

  onValues(values) {
    if (!this.outline) return;
    for (const kind of ["materials", "lights"]) {
      for (const [i, entry] of Object.entries(values[kind])) this.outline[kind][i] = entry;
      const shown = kind === "materials" ? this.material : this.light;
      if (shown in values[kind] && this.held === null) this.listParameters(kind);
    }
  }

  onScene(outline) {
    for (const kind of ["materials", "lights"]) outline[kind] = Object.values(outline[kind]);
    this.outline = outline;
    this.layer.replaceChildren(...Object.entries(outline.layers).map(([value, text]) => h("option", { value }, text)));
    this.denoiseRow.hidden = !outline.denoises;
    this.transform.replaceChildren(...outline.view_transforms.map((value) => h("option", { value }, TRANSFORMS[value] ?? value)));
    if (this.state) {
      this.layer.value = this.state.layer;
      this.transform.value = this.state.view_transform;
    }
    const listed = (list, entries, chosen) =>
      list.replaceChildren(...entries.map((m, i) => h("option", { value: i, selected: i === chosen }, `${m.name}  (${m.type})`)));
    this.material = Math.min(this.material, Math.max(0, outline.materials.length - 1));
    this.light = Math.min(this.light, Math.max(0, outline.lights.length - 1));
    listed(this.materialList, outline.materials, this.material);
    listed(this.lightList, outline.lights, this.light);
    this.materialSection.hidden = outline.materials.length === 0;
    this.lightSection.hidden = outline.lights.length === 0;
    this.listObjects();
    if (this.held === null) {
      this.listParameters("materials");
      this.listParameters("lights");
    }
  }

  listObjects() {
    const objects = this.outline?.objects ?? [];
    this.finder.hidden = objects.length < 12;
    const wanted = this.filter.toLowerCase();
    const found = objects.map((o, i) => ({ ...o, i })).filter((o) => o.name.toLowerCase().includes(wanted));
    const rows = found.slice(0, MOST_LISTED).map((o) => {
      const label = `${o.visible ? "Hide" : "Show"} ${o.name}`;
      const kinds = { sphere: "sphere", triangle: "triangle", instance: "copy" };
      const kind = kinds[o.kind] ?? o.kind;
      const many = o.count === 1 ? kind : kind === "copy" ? "copies" : `${kind}s`;
      return h(
        "li",
        { class: o.visible ? "" : "ph-off" },
        h("button", { type: "button", class: "ph-eye", "aria-label": label, "aria-pressed": String(o.visible), title: label, onclick: () => this.toggleObject(o.i) }, icon(o.visible ? "eye" : "hidden")),
        h("button", { type: "button", class: "ph-name", title: o.name, onclick: () => o.material != null && this.chooseMaterial(o.material) }, o.name),
        h("span", { class: "ph-dim" }, `${counted(o.count)} ${many}`),
      );
    });
    if (found.length > rows.length) rows.push(h("li", { class: "ph-dim" }, `and ${found.length - rows.length} more`));
    this.objects.replaceChildren(...rows);
  }

  toggleObject(index) {
    this.send("hide", { object: index, visible: !this.outline.objects[index].visible });
  }

  chooseMaterial(index) {
    this.material = index;
    this.materialList.value = String(index);
    this.materialSection.open = true;
    this.listParameters("materials");
  }

  listParameters(kind) {
    const index = kind === "materials" ? this.material : this.light;
    const entry = this.outline?.[kind][index];
    const change = (name) => (value) => this.send("change", { kind, index, name, value });
    this.parameters[kind].replaceChildren(...(entry?.params ?? []).map((p) => this.control(p, change(p.name))));
  }

  control(p, change) {
    const label = plainly(p.name);
    if (p.fixed) return h("div", { class: "ph-row", title: p.doc }, h("span", { class: "ph-label" }, label), h("span", { class: "ph-value ph-dim" }, "texture"));
    const id = this.id();
    const row = (...children) => h("div", { class: "ph-row", title: p.doc }, h("label", { for: id }, label), ...children);
    if (p.choices.length) {
      const list = h("select", { id, onchange: () => change(list.value) }, ...p.choices.map((c) => h("option", { selected: c === p.value }, c)));
      return row(list);
    }
    if (p.size === 1) {
      const high = p.high !== null && p.high <= 1e4 ? p.high : Math.max(1, 4 * p.value);
      const low = p.low === null || p.low < -1e4 ? -high : p.low;
      const { element } = this.slider(label, { low, high, step: 0, value: p.value }, change);
      element.title = p.doc;
      return element;
    }
    if (p.low === null || p.low < 0) {
      const inputs = p.value.map((v, i) =>
        h("input", { id: i ? null : id, type: "number", step: "any", value: short(v, 5), "aria-label": `${label}, ${"xyz"[i]}` }),
      );
      for (const input of inputs) {
        remember(input);
        input.addEventListener("change", () => entered(input) !== null && change(inputs.map((n) => Number(n.value))));
      }
      return row(h("span", { class: "ph-three" }, ...inputs));
    }
    if (p.high !== null && p.high <= 1) {
      const color = h("input", { id, type: "color", value: toHex(p.value), oninput: () => (this.hold(color), change(fromHex(color.value))) });
      return row(color);
    }
    // light: a colour, and how strong
    const most = Math.max(...p.value);
    let tint = most > 0 ? p.value.map((v) => v / most) : [1, 1, 1];
    let strength = most;
    const tell = () => change(tint.map((v) => v * strength));
    const color = h("input", {
      id,
      type: "color",
      value: toHex(tint),
      oninput: () => {
        this.hold(color);
        tint = fromHex(color.value);
        tell();
      },
    });
    const base = most > 0 ? most : 1;
    const slider = this.slider(`${label}, strength`, { low: base / 1000, high: base * 100, step: 0, value: base, log: true }, (v) => {
      strength = v;
      tell();
    });
    return h("div", { class: "ph-group", title: p.doc }, row(color), slider.element);
  }

  // --- What is told

  say(text, bad = false) {
    this.live.textContent = text;
    const toast = h("div", { class: bad ? "ph-toast ph-bad" : "ph-toast" }, text);
    this.toasts.append(toast);
    setTimeout(() => toast.remove(), bad ? 6000 : 2200);
  }

  tellNotice() {
    const text = this.connected === false ? "Connection lost. Trying again." : (this.state?.error ?? this.options.notice ?? "");
    this.notice.textContent = text;
    this.notice.hidden = !text;
  }

  tellStatus() {
    const { frame: f, state: s, figures } = this;
    const done = f && s && f.scale === 1 && f.spp >= s.spp;
    const what = !this.connected ? "offline" : s?.busy ? s.busy : done ? "done" : s?.paused ? "paused" : "rendering";
    this.root.dataset.doing = what === "rendering" || what === "done" || what === "paused" || what === "offline" ? what : "busy";
    const put = (key, text) => figures[key].textContent !== text && (figures[key].textContent = text);
    put("what", what.replace(/^./, (c) => c.toUpperCase()));
    if (!f || !s) return;
    put("size", `${s.width} × ${s.height}`);
    put("spp", `${f.spp.toLocaleString("en")} of ${s.spp.toLocaleString("en")} spp`);
    put("noise", f.error == null ? "" : `noise ${short(100 * f.error, f.error < 0.1 ? 2 : 3)} %`);
    figures.noise.hidden = f.error == null;
    put("rate", `${counted(f.rate)} samples/s`);
    put("memory", bytes(f.memory));
    put("time", clock(f.seconds));
    const share = f.scale < 1 ? 0 : Math.min(1, f.spp / s.spp);
    this.progress.firstChild.style.transform = `scaleX(${share})`;
    this.progress.setAttribute("aria-valuenow", String(Math.round(100 * share)));
  }

  tellCamera() {
    const c = this.camera;
    if (!c) return;
    const flat = c.projection === "orthographic";
    this.fov.element.hidden = flat || c.projection === "equirectangular";
    this.fov.set(c.fov ?? c.vfov ?? 40);
    const away = length(sub(c.eye, c.target));
    this.aperture.element.hidden = c.projection !== "perspective";
    this.aperture.reach(Math.max(0.05 * away, 1.5 * c.aperture_radius));
    this.aperture.set(c.aperture_radius);
    this.focusText.textContent = c.focus_distance == null ? `${short(away)}, at the target` : short(c.focus_distance);
  }

  tellCrop() {
    const part = this.state.crop;
    this.cropText.textContent = part ? part.map((v) => `${Math.round(100 * v)}%`).slice(2).join(" × ") : "all";
    this.cropClear.hidden = !part;
    if (!this.cropping) this.showCrop(part);
  }

  showCrop(part) {
    this.cropBox.hidden = !part;
    if (!part) return;
    const [x, y, w, h_] = part.map((v) => `${100 * v}%`);
    Object.assign(this.cropBox.style, { left: x, top: y, width: w, height: h_ });
  }

  // --- Sizes

  // Where the picture lies in the window: as large as fits, in its proportions.
  layOut() {
    const { clientWidth: w, clientHeight: h_ } = this.stage;
    const aspect = this.frame ? this.frame.width / this.frame.height : this.state ? this.state.width / this.state.height : 16 / 9;
    const width = Math.min(w, h_ * aspect);
    Object.assign(this.picture.style, { width: `${width}px`, height: `${width / aspect}px` });
    // on a phone the picture takes what it needs, and the panel the rest
    this.root.style.setProperty("--aspect", this.fill ? "1" : String(aspect));
  }

  // Asks for a picture that fits the window.
  fit(now = false) {
    clearTimeout(this.fitting);
    this.fitting = setTimeout(
      () => {
        const { clientWidth: w, clientHeight: h_ } = this.stage;
        if (!this.state || !this.connected || w < 8 || h_ < 8) return;
        const aspect = this.fill || this.state.aspect === null ? w / h_ : this.state.aspect;
        const wide = Math.min(w, h_ * aspect);
        // of twice the side, four times the samples: at most so many pixels
        const detail = Math.min(this.detail, Math.sqrt(8e6 / (wide * (wide / aspect))));
        const size = [wide * detail, (wide / aspect) * detail].map((v) => Math.max(8, Math.round(v)));
        if (this.sized?.join() === size.join()) return;
        this.sized = size;
        this.send("size", { width: size[0], height: size[1] });
      },
      now ? 0 : 160,
    );
  }

  // --- What the user does

  pause() {
    this.send("pause", { paused: !this.state?.paused });
  }

  async save(format) {
    this.say("Saving");
    try {
      const file = await this.ask("save", { format });
      const url = URL.createObjectURL(new Blob([file.data], { type: file.mime }));
      const link = h("a", { href: url, download: file.name });
      this.root.append(link);
      link.click();
      link.remove();
      setTimeout(() => URL.revokeObjectURL(url), 60000);
      this.say(`Saved ${file.name}`);
    } catch (error) {
      this.say(`Not saved: ${error.message}`, true);
    }
  }

  async copy(kind) {
    if (!this.camera) return;
    const text = kind === "json" ? asJson(this.camera) : asPython(this.camera);
    try {
      await navigator.clipboard.writeText(text);
    } catch {
      // only secure pages may; others by the old way
      const area = h("textarea", { class: "ph-hidden" });
      area.value = text;
      this.root.append(area);
      area.select();
      const copied = document.execCommand("copy");
      area.remove();
      if (!copied) return this.say("The browser does not let pages copy here", true);
    }
    this.say(kind === "json" ? "Camera copied as JSON" : "Camera copied as Python");
  }

  theme() {
    const now = this.root.dataset.theme ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
    const theme = now === "dark" ? "light" : "dark";
    this.root.dataset.theme = theme;
    localStorage.setItem("parhelion-theme", theme);
  }

  togglePanel() {
    const off = this.root.classList.toggle("ph-no-panel");
    this.panelButton.setAttribute("aria-pressed", String(!off));
  }

  choose(tool) {
    this.tool = tool;
    this.root.dataset.tool = tool;
    for (const [name, b] of Object.entries(this.toolButtons)) b.setAttribute("aria-pressed", String(name === tool));
  }

  // Another camera: shown in the panel now, sent with the next frame of the page.
  turn(camera) {
    if (!this.camera) return;
    this.camera = camera;
    this.tip.hidden = true;
    this.tellCamera();
    if (this.turning) return;
    this.turning = requestAnimationFrame(() => {
      this.turning = null;
      this.send("look", { camera: this.camera, stamp: this.stamped() });
    });
  }

  aspect() {
    return this.state ? this.state.width / this.state.height : 1;
  }

  // Pixels of the page to scene units at the target
  perPixel() {
    return tall(this.camera, this.aspect()) / Math.max(this.picture.clientHeight, 1);
  }

  orbit(dx, dy) {
    if (!this.camera) return;
    const k = Math.PI / Math.max(this.picture.clientHeight, 200);
    const side = this.camera.mirrored ? -1 : 1;
    this.turn(orbited(this.camera, side * k * dx, k * dy));
  }

  pan(dx, dy) {
    if (!this.camera) return;
    const k = this.perPixel();
    const side = this.camera.mirrored ? -1 : 1;
    this.turn(moved(this.camera, -side * k * dx, k * dy, 0));
  }

  dolly(factor) {
    if (this.camera) this.turn(dollied(this.camera, factor));
  }

  walk(x, y, z) {
    if (!this.camera) return;
    const step = 0.06 * length(sub(this.camera.eye, this.camera.target));
    this.turn(moved(this.camera, step * x, step * y, step * z));
  }

  setFov(angle) {
    if (!this.camera) return;
    const most = this.camera.projection === "fisheye" ? 360 : 170;
    const value = Math.max(0.1, Math.min(most, angle));
    this.turn(this.camera.fov != null ? { ...this.camera, fov: value } : { ...this.camera, vfov: value });
  }

  stamped() {
    this.stamp += 1;
    this.sent = { stamp: this.stamp, time: performance.now() };
    return this.stamp;
  }

  goHome() {
    cancelAnimationFrame(this.turning);
    this.turning = null;
    this.send("home", { stamp: this.stamped() });
  }

  crop(part) {
    this.cropping = null;
    this.send("crop", { part });
    this.showCrop(part);
  }

  brighter(stops) {
    if (!this.state) return;
    const exposure = Math.round(100 * (this.state.exposure + stops)) / 100;
    this.state.exposure = exposure;
    this.exposure.set(exposure);
    this.send("show", { exposure });
  }

  nextLayer(step) {
    const n = this.layer.options.length;
    this.layer.selectedIndex = (this.layer.selectedIndex + step + n) % n;
    this.send("show", { layer: this.layer.value });
    this.say(this.layer.selectedOptions[0].textContent);
  }

  // Shares of the picture at a place of the page, or null beside it
  at(e) {
    const box = this.picture.getBoundingClientRect();
    const x = (e.clientX - box.left) / box.width;
    const y = (e.clientY - box.top) / box.height;
    return x >= 0 && x <= 1 && y >= 0 && y <= 1 ? [x, y] : null;
  }

  async pick(place) {
    const [x, y] = place;
    return this.ask("pick", { x, y });
  }

  // What is under a pointer that rests
  async hover(e) {
    const place = this.at(e);
    if (!place || !this.connected || this.picking) return;
    this.picking = true;
    try {
      const seen = await this.pick(place);
      if (this.pointers.size || this.rested !== e) return;
      const box = this.stage.getBoundingClientRect();
      this.tip.replaceChildren(h("b", {}, seen.object ?? "Nothing"), seen.material ? h("span", {}, this.materialName(seen)) : null);
      this.tip.hidden = false;
      const x = Math.min(e.clientX - box.left + 14, box.width - this.tip.offsetWidth - 6);
      const y = Math.min(e.clientY - box.top + 16, box.height - this.tip.offsetHeight - 6);
      Object.assign(this.tip.style, { left: `${Math.max(6, x)}px`, top: `${Math.max(6, y)}px` });
    } catch {
      // the next rest of the pointer asks again
    } finally {
      this.picking = false;
    }
  }

  materialName(seen) {
    const type = this.outline?.materials[seen.material_index]?.type;
    return type && type !== seen.material ? `${seen.material} (${type})` : seen.material;
  }

  async select(place) {
    try {
      const seen = await this.pick(place);
      const line = (name, value) => [h("dt", {}, name), h("dd", {}, value)];
      const three = (v) => v.map((x) => short(x, 4)).join("  ");
      if (seen.object === null) {
        this.place.replaceChildren(h("p", { class: "ph-dim" }, "Nothing is there."));
      } else {
        this.place.replaceChildren(
          h(
            "dl",
            {},
            ...line("Object", seen.object),
            ...line("Material", this.materialName(seen)),
            ...line("Distance", short(seen.distance, 4)),
            ...line("Position", three(seen.position)),
            ...line("Normal", three(seen.normal)),
            ...(seen.value ? line("Light", three(seen.value)) : []),
          ),
        );
        this.chooseMaterial(seen.material_index);
        this.say(`${seen.object}: ${this.materialName(seen)}`);
      }
      this.showMark(place);
    } catch (error) {
      this.say(error.message, true);
    }
  }

  showMark([x, y], kind = "") {
    this.mark.className = `ph-mark ${kind}`;
    Object.assign(this.mark.style, { left: `${100 * x}%`, top: `${100 * y}%` });
    this.mark.hidden = false;
    clearTimeout(this.marked);
    this.marked = setTimeout(() => (this.mark.hidden = true), 1200);
  }

  async focusAt(place) {
    try {
      const seen = await this.pick(place);
      if (seen.depth === null || seen.depth <= 0) return this.say("Nothing is there to focus on", true);
      this.turn({ ...this.camera, focus_distance: seen.depth });
      this.showMark(place, "ph-focus");
      this.say(`Focus at ${short(seen.depth)}${this.camera.aperture_radius ? "" : "; the aperture is 0"}`);
      this.choose("orbit");
    } catch (error) {
      this.say(error.message, true);
    }
  }

  // From now on the camera turns about what is there.
  async centre(place) {
    try {
      const seen = await this.pick(place);
      if (seen.position) this.turn({ ...this.camera, target: seen.position });
      this.showMark(place);
    } catch (error) {
      this.say(error.message, true);
    }
  }

  // --- Mouse, touch, keyboard

  listen() {
    const { stage } = this;
    const on = (target, name, action, options = {}) => target.addEventListener(name, action, { signal: this.ends.signal, ...options });
    on(stage, "pointerdown", (e) => this.down(e));
    on(stage, "pointermove", (e) => this.move(e));
    on(stage, "pointerup", (e) => this.up(e));
    on(stage, "pointercancel", (e) => (this.pointers.delete(e.pointerId), (this.cropping = null)));
    on(stage, "pointerleave", () => ((this.tip.hidden = true), clearTimeout(this.resting)));
    on(stage, "contextmenu", (e) => e.preventDefault());
    on(stage, "wheel", (e) => this.wheel(e), { passive: false });
    on(this.options.widget ? this.root : window, "keydown", (e) => this.key(e));
    this.observer = new ResizeObserver(() => (this.layOut(), this.fit()));
    this.observer.observe(stage);
  }

  down(e) {
    if (e.button > 2) return;
    this.tip.hidden = true;
    clearTimeout(this.resting);
    this.root.classList.add("ph-pointing");
    this.stage.focus({ preventScroll: true });
    this.stage.setPointerCapture(e.pointerId);
    this.pointers.set(e.pointerId, { x: e.clientX, y: e.clientY, startX: e.clientX, startY: e.clientY, button: e.button });
    this.still = this.pointers.size === 1;
    if (this.tool === "crop" && this.pointers.size === 1) this.cropping = this.at(e);
    e.preventDefault();
  }

  move(e) {
    const p = this.pointers.get(e.pointerId);
    if (!p) {
      if (e.pointerType !== "mouse" || e.target !== this.stage && !this.picture.contains(e.target)) return;
      this.tip.hidden = true;
      clearTimeout(this.resting);
      this.rested = e;
      this.resting = setTimeout(() => this.hover(e), REST);
      return;
    }
    const dx = e.clientX - p.x;
    const dy = e.clientY - p.y;
    if (this.still && Math.hypot(e.clientX - p.startX, e.clientY - p.startY) < STILL) return;
    this.still = false;
    if (this.pointers.size === 2) {
      const [other] = [...this.pointers.entries()].filter(([id]) => id !== e.pointerId).map(([, q]) => q);
      const before = Math.hypot(p.x - other.x, p.y - other.y);
      const after = Math.hypot(e.clientX - other.x, e.clientY - other.y);
      p.x = e.clientX;
      p.y = e.clientY;
      if (before > 10 && after > 10) this.dolly(before / after);
      this.pan(dx / 2, dy / 2);
      return;
    }
    p.x = e.clientX;
    p.y = e.clientY;
    if (this.cropping) this.showCrop(this.cropOf(e));
    else if (p.button === 2 || p.button === 1 || e.shiftKey) this.pan(dx, dy);
    else if (e.ctrlKey || e.metaKey) this.dolly(Math.exp(0.006 * dy));
    else if (this.tool !== "crop") this.orbit(dx, dy);
  }

  up(e) {
    const p = this.pointers.get(e.pointerId);
    this.pointers.delete(e.pointerId);
    if (!p) return;
    if (this.cropping) {
      const part = this.cropOf(e);
      const { clientWidth: w, clientHeight: h_ } = this.picture;
      this.crop(part[2] * w < 4 || part[3] * h_ < 4 ? null : part);
      this.choose("orbit");
      return;
    }
    const place = this.at(e);
    if (!this.still || !place || p.button !== 0) return;
    if (this.tool === "focus") return void this.focusAt(place);
    const last = this.clicked;
    this.clicked = { time: e.timeStamp, x: e.clientX, y: e.clientY };
    if (last && e.timeStamp - last.time < DOUBLE && Math.hypot(e.clientX - last.x, e.clientY - last.y) < 20) {
      this.clicked = null;
      this.centre(place);
    } else this.select(place);
  }

  cropOf(e) {
    const box = this.picture.getBoundingClientRect();
    const share = (v) => Math.max(0, Math.min(1, v));
    const x = share((e.clientX - box.left) / box.width);
    const y = share((e.clientY - box.top) / box.height);
    const [x0, y0] = this.cropping;
    return [Math.min(x, x0), Math.min(y, y0), Math.abs(x - x0), Math.abs(y - y0)];
  }

  wheel(e) {
    e.preventDefault();
    const lines = e.deltaMode === 1 ? 16 : e.deltaMode === 2 ? 200 : 1;
    const amount = Math.max(-240, Math.min(240, lines * (e.deltaY || e.deltaX)));
    if (e.altKey) {
      if (this.camera) this.setFov((this.camera.fov ?? this.camera.vfov ?? 40) * Math.exp(0.001 * amount));
    } else this.dolly(Math.exp((e.ctrlKey ? 0.008 : 0.0015) * amount));
  }

  key(e) {
    this.root.classList.remove("ph-pointing");
    const tag = e.target.tagName;
    if (this.help.open || e.target.closest?.("[role=menu]")) return;
    const slides = e.target.type === "range" && !MOVES.has(e.key);
    const ticks = (e.target.type === "checkbox" || e.target.type === "color") && e.key !== " " && e.key !== "Enter";
    const control = tag === "INPUT" || tag === "SELECT" || tag === "TEXTAREA" || e.target.isContentEditable;
    const typing = control && !slides && !ticks;
    const command = e.ctrlKey || e.metaKey;
    if (command && e.key.toLowerCase() === "s") {
      e.preventDefault();
      this.save(e.shiftKey ? "exr" : "png");
      return;
    }
    if (typing || command || e.altKey) return;
    if (e.key === " " && (tag === "BUTTON" || tag === "SUMMARY")) return;
    const angle = 24; // pixels of a drag
    const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const steps = { w: [0, 0, 1], s: [0, 0, -1], a: [-1, 0, 0], d: [1, 0, 0], q: [0, -1, 0], e: [0, 1, 0] };
    // Caps Lock makes no other keys of them
    const name = e.key.length > 1 ? e.key : e.shiftKey ? e.key.toUpperCase() : e.key.toLowerCase();
    const actions = {
      "+": () => this.dolly(0.9),
      "=": () => this.dolly(0.9),
      "-": () => this.dolly(1 / 0.9),
      "[": () => this.setFov((this.camera?.fov ?? this.camera?.vfov ?? 40) * 0.95),
      "]": () => this.setFov((this.camera?.fov ?? this.camera?.vfov ?? 40) / 0.95),
      " ": () => this.pause(),
      h: () => this.goHome(),
      Home: () => this.goHome(),
      f: () => this.choose(this.tool === "focus" ? "orbit" : "focus"),
      c: () => this.choose(this.tool === "crop" ? "orbit" : "crop"),
      ",": () => this.brighter(-0.25),
      ".": () => this.brighter(0.25),
      l: () => this.nextLayer(1),
      L: () => this.nextLayer(-1),
      j: () => this.copy("json"),
      p: () => this.copy("python"),
      t: () => this.togglePanel(),
      "?": () => this.help.showModal(),
      Escape: () => (this.tool === "orbit" && this.state?.crop ? this.crop(null) : this.choose("orbit")),
    };
    if (e.key in arrows) {
      const [x, y] = arrows[e.key].map((v) => v * angle);
      if (e.shiftKey) this.pan(-x, -y);
      else this.orbit(-x, -y);
    } else if (e.key.toLowerCase() in steps) this.walk(...steps[e.key.toLowerCase()]);
    else if (name in actions) actions[name]();
    else return;
    e.preventDefault();
  }
}

/** Shows a session in an element; what is returned closes it. */
export function mount(element, carrier, options) {
  const view = new View(element, carrier, options);
  return () => view.close();
}

export default {
  render({ model, el }) {
    const element = h("div", {});
    element.style.setProperty("--parhelion-height", `${model.get("height")}px`);
    el.append(element);
    return mount(element, new Model(model), { widget: true });
  },
};

const page = document.querySelector("body[data-parhelion]");
if (page) {
  const url = new URL("session", location.href);
  url.protocol = url.protocol.replace("http", "ws");
  mount(page, new Socket(url));
}
