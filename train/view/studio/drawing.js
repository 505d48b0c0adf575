// The table on which motions are drawn: it shows what it is told, and says what the pointer does. Lengths are those of the
// problem, y upwards; what the pointer does is said in them, with its own time stamps in seconds.
const COLOURS = {
  field: "#9fb3c8", demonstration: "#5b6b7b", sketch: "#1b2733", gaussian: "#b8860b", imitated: "#5b6b7b", motion: "#c0392b",
  trial: "#1f5fa8", wall: "#1b2733", region: "rgba(192, 57, 43, 0.16)", rim: "#c0392b", mark: "#000000", mass: "#2a7f4f",
  ground: "#ffffff", grid: "#e7ecf1",
};
const NEAR = 16; // pixels
const MOST = 4000; // points of a stroke; of more, every second one goes: a message has to stay below a megabyte

// All multiples of a step from low to high; counted, since beside a large number a small step adds nothing.
export function multiples(step, low, high) {
  const first = Math.ceil(low / step), n = Math.floor(high / step) - first + 1;
  return Array.from({ length: Math.min(n, 1000) || 0 }, (_, i) => (first + i) * step);
}

export default {
  template: `<canvas tabindex="0" role="img" :aria-label="label"
    style="width: 100%; height: 100%; display: block; touch-action: none; border-radius: 6px"></canvas>`,
  props: { label: String, tool: String, active: Boolean },
  emits: ["ready", "stroke", "place", "drag", "erase", "pull"],
  mounted() {
    this.layers = { view: [-1, 1, -0.625, 0.625] };
    this.drawn = 0; // pictures so far
    this.pointer = null;
    const events = { pointerdown: this.down, pointermove: this.move, pointerup: this.up, pointercancel: this.up };
    if (this.active) for (const [name, call] of Object.entries(events)) this.$el.addEventListener(name, call);
    this.observer = new ResizeObserver(() => {
      this.say();
      this.ask();
    });
    this.observer.observe(this.$el);
  },
  unmounted() {
    this.observer.disconnect();
  },
  watch: {
    tool() { this.$el.style.cursor = { move: "grab", pull: "grab", erase: "not-allowed" }[this.tool] || "crosshair"; },
  },
  methods: {
    // ---------------------------------------------------------------- what is said and heard
    say() {
      // Before there is a connection events wait, and may overtake each other; so what waits is this, and says how it is then.
      if (!window.did_handshake) return setTimeout(() => this.say(), 10);
      const width = this.$el.clientWidth, height = this.$el.clientHeight;
      if (width && height) this.$emit("ready", { width, height });
    },
    show(layers) {
      Object.assign(this.layers, layers);
      this.ask();
    },
    ask() {
      if (this.waiting) return;
      this.waiting = true;
      requestAnimationFrame(() => { this.waiting = false; this.draw(); });
    },
    at(event) {
      const box = this.$el.getBoundingClientRect(), { scale, left, bottom } = this.frame();
      const place = [(event.clientX - box.left - left) / scale, (bottom - (event.clientY - box.top)) / scale];
      const digits = Math.min(Math.max(Math.ceil(Math.log10(scale)) + 2, 0), 20); // a hundredth of a pixel
      return place.map((x) => +x.toFixed(digits));
    },
    stamped(event) {
      const [x, y] = this.at(event);
      return [+(event.timeStamp / 1000).toFixed(5), x, y];
    },
    down(event) {
      if (event.button > 0 || this.pointer) return;
      this.$el.setPointerCapture(event.pointerId);
      const here = this.at(event);
      this.pointer = { id: event.pointerId, tool: this.tool, from: here, points: [this.stamped(event)], held: null, told: 0 };
      if (this.tool === "move") this.pointer.held = this.nearest(here, ["start", "goal", "via"]);
      if (this.tool === "erase") {
        const found = this.nearest(here, ["via", "walls", "regions", "strokes"]);
        if (found) this.$emit("erase", found);
      }
      if (this.tool === "pull") this.$emit("pull", { at: here });
      this.ask();
    },
    move(event) {
      const pointer = this.pointer;
      if (!pointer || pointer.id !== event.pointerId) return;
      const events = event.getCoalescedEvents ? event.getCoalescedEvents() : [];
      for (const each of events.length ? events : [event]) pointer.points.push(this.stamped(each));
      if (pointer.points.length > MOST) pointer.points = pointer.points.filter((_, i) => i % 2 === 0 || i === MOST);
      this.tell(false);
      this.ask();
    },
    up(event) {
      const pointer = this.pointer;
      if (!pointer || pointer.id !== event.pointerId) return;
      this.pointer = null;
      const last = pointer.points[pointer.points.length - 1].slice(1), tool = pointer.tool; // it may be another one by now
      const to = event.type === "pointercancel" ? last : this.at(event); // what is cancelled is nowhere
      if (tool === "draw") this.$emit("stroke", { points: pointer.points, done: true });
      if (tool === "via") this.$emit("place", { kind: "via", from: to, to });
      if (tool === "wall") this.$emit("place", { kind: "walls", from: pointer.from, to });
      if (tool === "region") this.$emit("place", { kind: "regions", from: pointer.from, to });
      if (tool === "move" && pointer.held) this.$emit("drag", { ...pointer.held, at: to, done: true });
      if (tool === "pull") this.$emit("pull", { at: null });
      this.ask();
    },
    tell(now) {
      // At most one message in a picture for what is dragged, and five in a second for what is drawn.
      const pointer = this.pointer, tool = pointer.tool, time = performance.now();
      if (time - pointer.told < (tool === "draw" ? 200 : 15)) return;
      pointer.told = time;
      const at = pointer.points[pointer.points.length - 1].slice(1);
      if (tool === "draw") this.$emit("stroke", { points: pointer.points, done: false });
      if (tool === "move" && pointer.held) this.$emit("drag", { ...pointer.held, at, done: false });
      if (tool === "pull") this.$emit("pull", { at });
    },
    nearest(here, kinds) {
      const { scale } = this.frame(), found = { distance: NEAR / scale };
      const look = (kind, index, distance) => {
        if (distance < found.distance) Object.assign(found, { kind, index, distance });
      };
      const away = (p) => Math.hypot(p[0] - here[0], p[1] - here[1]);
      for (const kind of kinds) {
        const items = this.layers[kind] || [];
        if (kind === "start" || kind === "goal") { if (items.length) look(kind, 0, away(items)); continue; }
        items.forEach((item, index) => {
          if (kind === "via") look(kind, index, away(item));
          if (kind === "regions") look(kind, index, Math.max(0, away(item) - item[2]));
          if (kind === "walls") for (let s = 0; s <= 20; s++)
            look(kind, index, away([0, 1].map((d) => item[0][d] + (s / 20) * (item[1][d] - item[0][d]))));
          if (kind === "strokes") item.forEach((point) => look(kind, index, away(point)));
        });
      }
      return found.kind ? { kind: found.kind, index: found.index } : null;
    },
    // ---------------------------------------------------------------- the picture
    frame() {
      const [left, right, low, high] = this.layers.view;
      const width = this.$el.clientWidth, height = this.$el.clientHeight;
      const scale = Math.min(width / (right - left), height / (high - low));
      return {
        scale, width, height,
        left: (width - scale * (left + right)) / 2,
        bottom: (height + scale * (low + high)) / 2,
      };
    },
    draw() {
      const { scale, width, height, left, bottom } = this.frame();
      const canvas = this.$el, ratio = window.devicePixelRatio || 1, l = this.layers;
      if (!width || !height) return;
      if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
      if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
      const c = canvas.getContext("2d");
      c.setTransform(ratio, 0, 0, ratio, 0, 0);
      c.fillStyle = COLOURS.ground;
      c.fillRect(0, 0, width, height);
      const X = (p) => left + scale * p[0], Y = (p) => bottom - scale * p[1];
      const line = (points, colour, size, dash = [], alpha = 1) => {
        if (!points || points.length < 2) return;
        c.beginPath();
        points.forEach((p, i) => (i ? c.lineTo(X(p), Y(p)) : c.moveTo(X(p), Y(p))));
        c.strokeStyle = colour; c.lineWidth = size; c.setLineDash(dash); c.globalAlpha = alpha;
        c.lineJoin = c.lineCap = "round";
        c.stroke();
        c.setLineDash([]); c.globalAlpha = 1;
      };
      const disc = (p, radius, fill, rim) => {
        c.beginPath();
        c.arc(X(p), Y(p), radius, 0, 2 * Math.PI);
        if (fill) { c.fillStyle = fill; c.fill(); }
        if (rim) { c.strokeStyle = rim; c.lineWidth = 1.6; c.stroke(); }
      };
      this.ruled(c, width, height, X, Y, line);
      for (const [from, to] of l.field || []) this.arrow(c, X(from), Y(from), X(to), Y(to));
      for (const [x, y, r] of l.regions || []) disc([x, y], scale * r, COLOURS.region, COLOURS.rim);
      for (const wall of l.walls || []) line(wall, COLOURS.wall, 5);
      for (const path of l.strokes || []) line(path, COLOURS.demonstration, 1.6, [6, 4]);
      for (const path of l.gaussians || []) line(path, COLOURS.gaussian, 1.8);
      for (const path of l.trials || []) line(path, COLOURS.trial, 1, [], 0.35);
      for (const path of l.imitated || []) line(path, COLOURS.imitated, 2.4);
      for (const path of l.motion || []) line(path, COLOURS.motion, 2.6);
      for (const p of l.via || []) {
        disc(p, 8, "rgba(255, 255, 255, 0.8)", COLOURS.mark);
        for (const [dx, dy] of [[1, 1], [1, -1]]) {
          c.beginPath(); c.moveTo(X(p) - 5 * dx, Y(p) - 5 * dy); c.lineTo(X(p) + 5 * dx, Y(p) + 5 * dy); c.stroke();
        }
      }
      if (l.start && l.start.length) { c.fillStyle = COLOURS.mark; c.fillRect(X(l.start) - 6, Y(l.start) - 6, 12, 12); }
      if (l.goal && l.goal.length) this.star(c, X(l.goal), Y(l.goal));
      if (l.mass) this.pulled(c, l.mass, X, Y, line, disc);
      this.legend(c, width);
      const pointer = this.pointer;
      if (pointer && pointer.tool === "draw") line(pointer.points.map((p) => p.slice(1)), COLOURS.sketch, 3);
      if (pointer && (pointer.tool === "wall" || pointer.tool === "region")) {
        const to = pointer.points[pointer.points.length - 1].slice(1);
        if (pointer.tool === "wall") line([pointer.from, to], COLOURS.wall, 5, [], 0.5);
        else disc(pointer.from, scale * Math.hypot(to[0] - pointer.from[0], to[1] - pointer.from[1]), COLOURS.region, COLOURS.rim);
      }
      canvas.dataset.drawn = ++this.drawn;
    },
    legend(c, width) {
      const names = { strokes: ["demonstrations", COLOURS.demonstration, [6, 4]], gaussians: ["Gaussians", COLOURS.gaussian, []],
        imitated: ["imitated", COLOURS.imitated, []], trials: ["trials", COLOURS.trial, []], motion: ["learned", COLOURS.motion, []] };
      const seen = Object.entries(names).filter(([layer]) => (this.layers[layer] || []).length);
      c.font = "12px sans-serif";
      c.fillStyle = "rgba(255, 255, 255, 0.8)";
      if (seen.length) c.fillRect(width - 134, 4, 130, 6 + 17 * seen.length);
      seen.forEach(([, [name, colour, dash]], i) => {
        const y = 16 + 17 * i;
        c.strokeStyle = colour; c.lineWidth = 2.2; c.setLineDash(dash);
        c.beginPath(); c.moveTo(width - 128, y); c.lineTo(width - 102, y); c.stroke(); c.setLineDash([]);
        c.fillStyle = "#1b2733"; c.fillText(name, width - 96, y + 4);
      });
    },
    ruled(c, width, height, X, Y, line) {
      const [left, right, low, high] = this.layers.view;
      const rough = (right - left) / 8, power = 10 ** Math.floor(Math.log10(rough));
      const step = power * ([1, 2, 5].find((n) => n * power >= rough) || 10);
      const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
      c.font = "11px sans-serif"; c.fillStyle = "#5b6b7b";
      for (const x of multiples(step, left, right)) {
        line([[x, low], [x, high]], COLOURS.grid, 1);
        c.fillText(x.toFixed(digits), X([x, 0]) + 3, height - 5);
      }
      for (const y of multiples(step, low, high)) {
        line([[left, y], [right, y]], COLOURS.grid, 1);
        c.fillText(y.toFixed(digits), 4, Y([0, y]) - 3);
      }
      c.fillText(this.layers.unit ? `[${this.layers.unit}]` : "", 4, 14);
    },
    arrow(c, x, y, tox, toy) {
      const angle = Math.atan2(toy - y, tox - x), length = Math.hypot(tox - x, toy - y);
      c.strokeStyle = COLOURS.field; c.lineWidth = 1.1;
      c.beginPath(); c.moveTo(x, y); c.lineTo(tox, toy);
      if (length > 3) for (const turn of [2.6, -2.6]) {
        c.moveTo(tox, toy); c.lineTo(tox + 4 * Math.cos(angle + turn), toy + 4 * Math.sin(angle + turn));
      }
      c.stroke();
    },
    star(c, x, y) {
      c.beginPath();
      for (let i = 0; i < 10; i++) {
        const radius = i % 2 ? 5 : 12, angle = -Math.PI / 2 + (i * Math.PI) / 5;
        c.lineTo(x + radius * Math.cos(angle), y + radius * Math.sin(angle));
      }
      c.closePath();
      c.fillStyle = COLOURS.mark; c.fill(); c.strokeStyle = "white"; c.lineWidth = 1; c.stroke();
    },
    pulled(c, mass, X, Y, line, disc) {
      if (mass.trail) line(mass.trail, COLOURS.mass, 2.4);
      if (mass.reference) { line([mass.reference, mass.at], "#9b59b6", 1.4, [3, 3]); disc(mass.reference, 5, null, "#9b59b6"); }
      if (mass.hand) { line([mass.at, mass.hand], "#d35400", 3); disc(mass.hand, 6, "#d35400"); }
      disc(mass.at, 11, COLOURS.mass, "white");
    },
  },
};
