// The canvas: where the figures stand, colours of the page's scheme, turning and zooming by hand.

// "#rrggbb" as three numbers.
const parseColour = (colour) => [1, 3, 5].map((k) => parseInt(colour.slice(k, k + 2), 16));

// Between two colours, each three numbers.
const mixColours = (a, b, share) => `rgb(${a.map((value, k) => Math.round((1 - share) * value + share * b[k])).join(",")})`;

function toneSet(colour, blackness) {
  const towards = (target, share) => mixColours(parseColour(colour), [target, target, target], share);
  return { light: towards(255, 0.42), base: colour, dark: towards(0, 0.3), line: towards(0, blackness) };
}

function hexColour(context, style, name) {
  context.fillStyle = "#808080";
  context.fillStyle = style.getPropertyValue(name).trim();
  return context.fillStyle; // the browser writes any opaque colour as #rrggbb
}

function darker(colour, share) {
  const values = parseColour(colour).map((value) => Math.round(value * (1 - share)));
  return `#${values.map((value) => value.toString(16).padStart(2, "0")).join("")}`;
}

function pixelRatio() {
  return Math.min(window.devicePixelRatio || 1, 3);
}

const LEAST_ROOM = 48; // px, below which there is nothing to see

class Stage {
  constructor(root, canvas, changed) {
    this.root = root;
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.layer = document.createElement("canvas"); // the ghost is made here, then laid down as one translucent thing
    this.camera = new Camera();
    this.changed = changed;
    this.ratio = 1;
    this.hands = new AbortController();
    this.readColours();
    this.listen();
    this.resize();
  }

  listen() {
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(this.canvas);
    this.endTheme = onTheme(() => this.after(() => this.readColours()));
    const hooks = {
      press: () => this.root.focus({ preventScroll: true }),
      turn: (across, down) => this.after(() => this.camera.turn(-0.008 * across, 0.006 * down)),
      scale: (factor) => this.after(() => this.camera.scaleBy(factor)),
      reset: () => this.after(() => this.camera.reset()),
      takesWheel: () => this.root.contains(document.activeElement),
    };
    watchHands(this.canvas, hooks, this.hands.signal);
  }

  after(action) {
    const result = action();
    this.changed();
    return result;
  }

  readColours() {
    const style = getComputedStyle(this.root);
    const read = (name) => hexColour(this.context, style, name);
    this.performance = toneSet(read("--dp-performance"), 0.62);
    this.performance.hair = toneSet(darker(read("--dp-performance"), 0.42), 0.5);
    this.reference = toneSet(read("--dp-reference"), 0.58);
    this.reference.hair = toneSet(darker(read("--dp-reference"), 0.38), 0.5);
    this.accent = toneSet(read("--dp-accent"), 0.68);
    this.shown = toneSet(read("--dp-shown"), 0.66);
    this.ghost = { ...this.reference, line: read("--dp-ghost-line") };
    this.ghostShown = { ...this.shown, line: this.ghost.line };
    this.grid = read("--dp-grid");
    this.floor = read("--dp-floor");
    this.shadow = style.getPropertyValue("--dp-shadow").trim();
    this.hatch = null;
  }

  resize() {
    const box = this.canvas.getBoundingClientRect();
    this.ratio = pixelRatio();
    const [width, height] = [box.width, box.height].map((size) => Math.max(Math.round(size * this.ratio), 1));
    if (this.canvas.width !== width || this.canvas.height !== height) {
      for (const canvas of [this.canvas, this.layer]) [canvas.width, canvas.height] = [width, height];
      this.hatch = null;
    }
    this.changed();
  }

  getHatch() {
    if (!this.hatch) {
      const tile = document.createElement("canvas");
      const size = Math.round(6 * this.ratio);
      [tile.width, tile.height] = [size, size];
      const context = tile.getContext("2d");
      context.strokeStyle = this.accent.line;
      context.globalAlpha = 0.75;
      context.lineWidth = 1.3 * this.ratio;
      context.beginPath();
      for (const shift of [-size, 0, size]) {
        context.moveTo(shift - 1, size + 1);
        context.lineTo(shift + size + 1, -1);
      }
      context.stroke();
      this.hatch = this.context.createPattern(tile, "repeat");
    }
    return this.hatch;
  }

  // scene: reference (or null) and performance {body, place, home, clip}, seen, view, wrong.
  draw(scene) {
    if (pixelRatio() !== this.ratio) this.resize(); // another screen, another zoom of the page
    const { context, canvas } = this;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, canvas.width, canvas.height);
    if (Math.min(canvas.width, canvas.height) < LEAST_ROOM * this.ratio) return; // hidden, or not laid out yet
    const figures = [scene.reference, scene.performance].filter(Boolean);
    const room = this.roomOf(scene, figures);
    if (figures.length === 1 || scene.view.mode === "over") {
      const rect = { x: 0, y: 0, width: canvas.width, height: canvas.height };
      this.aim(scene, this.homeOf(scene, figures), room, rect);
      this.drawFloor(scene, room.reach, figures);
      if (scene.reference) this.drawOver(scene);
      else this.drawAlone(scene, scene.performance);
      return;
    }
    const half = canvas.width / 2;
    figures.forEach((figure, index) => {
      const rect = { x: index * half, y: 0, width: half, height: canvas.height };
      context.save();
      context.beginPath();
      context.rect(rect.x, rect.y, rect.width, rect.height);
      context.clip();
      this.aim(scene, this.homeOf(scene, [figure]), room, rect);
      this.drawFloor(scene, room.reach, [figure]);
      this.drawAlone(scene, figure);
      context.restore();
    });
  }

  // The same room for both, so that sizes can be compared.
  roomOf(scene, figures) {
    const most = (name) => Math.max(...figures.map((figure) => figure.clip[name]));
    const travel = scene.view.inPlace ? 0 : scene.follow ? 0.9 : scene.travel;
    return { reach: most("reach") + travel, ground: 0.35 + travel, height: most("top") };
  }

  homeOf(scene, figures) {
    if (scene.view.inPlace) return [0, 0];
    const homes = figures.map((figure) => figure.home);
    return [0, 1].map((k) => homes.reduce((sum, home) => sum + home[k] / homes.length, 0));
  }

  aim(scene, home, room, rect) {
    const sign = scene.view.mirror ? -1 : 1;
    // The words above the figures and a little floor below them stay free.
    const free = { ...rect, y: rect.y + 26 * this.ratio, height: rect.height - 36 * this.ratio };
    this.camera.frame([sign * home[0], room.height / 2 - 0.03, home[1]], room, free);
  }

  drawFloor(scene, reach, figures) {
    const { camera, context } = this;
    const [spot, ground] = [[0, 0, 0, 0], -0.035];
    const [x, , z] = camera.target;
    const radius = reach + 0.45;
    camera.project(x, ground, z, spot, 0);
    const fade = context.createRadialGradient(spot[0], spot[1], 0, spot[0], spot[1], radius * spot[3]);
    fade.addColorStop(0, this.grid);
    fade.addColorStop(0.55, this.grid);
    fade.addColorStop(1, `${this.grid}20`);
    context.beginPath();
    for (let k = 0; k < 48; k += 1) {
      const angle = (k * Math.PI) / 24;
      camera.project(x + radius * Math.cos(angle), ground, z + radius * Math.sin(angle), spot, 0);
      context.lineTo(spot[0], spot[1]);
    }
    context.fillStyle = this.floor;
    context.fill();
    context.beginPath();
    const line = (from, to) => {
      camera.project(from[0], ground, from[1], spot, 0);
      context.moveTo(spot[0], spot[1]);
      camera.project(to[0], ground, to[1], spot, 0);
      context.lineTo(spot[0], spot[1]);
    };
    const chord = (offset) => Math.sqrt(Math.max(radius * radius - offset * offset, 0));
    for (let c = Math.ceil((x - radius) * 2) / 2; c < x + radius; c += 0.5) {
      line([c, z - chord(c - x)], [c, z + chord(c - x)]);
    }
    for (let c = Math.ceil((z - radius) * 2) / 2; c < z + radius; c += 0.5) {
      line([x - chord(c - z), c], [x + chord(c - z), c]);
    }
    context.strokeStyle = fade;
    context.lineWidth = this.ratio;
    context.stroke();
    for (const figure of figures) {
      paintShadow(context, figure.body, figure.place, scene.view.mirror, camera, ground, this.shadow);
    }
  }

  project(scene, figure, wrong) {
    return projectBody(figure.body, figure.place, scene.view.mirror, this.camera, wrong);
  }

  drawAlone(scene, figure) {
    const parts = this.project(scene, figure, scene.wrong);
    if (figure === scene.performance) {
      paintSolid(this.context, parts, this.performance, this.accent, this.getHatch(), this.ratio);
    } else if (scene.seen) {
      // The same limbs of the model are only pointed out: nothing is wrong with them.
      paintSolid(this.context, parts, this.reference, this.shown, null, this.ratio);
    } else {
      this.onLayer((layer) => paintGhost(layer, parts, this.ghost, this.ghostShown, this.ratio), 0.35);
    }
  }

  drawOver(scene) {
    const model = this.project(scene, scene.reference, new Set());
    const own = this.project(scene, scene.performance, scene.wrong);
    const weight = scene.seen ? 1 : 0.45;
    const marked = new Set(scene.wrong);
    for (const part of model) part.marked = marked.has(PART_SEGMENT[part.name]);
    this.onLayer((layer) => paintGhost(layer, model, this.ghost, this.ghostShown, this.ratio), 0.6 * weight);
    paintSolid(this.context, own, this.performance, this.accent, this.getHatch(), this.ratio);
    this.onLayer((layer) => paintGhostOutline(layer, model, this.ghost, this.ratio), 0.85 * weight);
  }

  onLayer(paint, alpha) {
    const layer = this.layer.getContext("2d");
    layer.clearRect(0, 0, this.layer.width, this.layer.height);
    paint(layer);
    this.context.globalAlpha = alpha;
    this.context.drawImage(this.layer, 0, 0);
    this.context.globalAlpha = 1;
  }

  destroy() {
    this.hands.abort();
    this.observer.disconnect();
    this.endTheme();
  }
}
