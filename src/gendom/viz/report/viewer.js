// Plays clouds, arm and goal, in a view that turns.
// Points are in tenths of a millimetre, the arm is in millimetres.
(() => {
  const OPACITY = { recorded: 0.85, simulated: 0.6 };
  const probe = document.body.appendChild(document.createElement("i"));
  probe.hidden = true;

  // A colour of the style sheet as a canvas takes it.
  function color(name) {
    probe.style.color = `var(--${name})`;
    return getComputedStyle(probe).color;
  }

  // Orthographic, z up; as `gendom.viz.clouds.Projection`. Depth grows away from the eye.
  function projection({ turn, tilt }) {
    const [c, s, ct, st] = [Math.cos(turn), Math.sin(turn), Math.cos(tilt), Math.sin(tilt)];
    return ([x, y, z]) => {
      const ahead = c * y - s * x;
      return [c * x + s * y, st * ahead + ct * z, ct * ahead - st * z];
    };
  }

  function line(pen, points) {
    pen.beginPath();
    points.forEach((p, k) => pen[k ? "lineTo" : "moveTo"](p[0], p[1]));
    pen.stroke();
  }

  class Viewer {
    constructor(root) {
      this.root = root;
      this.scene = JSON.parse(document.getElementById(root.dataset.scene).textContent);
      this.play = root.querySelector("button.play");
      this.slider = root.querySelector("input.time");
      this.fade = root.querySelector("input.fade");
      this.speed = root.querySelector("select.speed");
      this.clock = root.querySelector("output");
      this.layers = [...root.querySelectorAll("input[data-layer]")];
      this.last = this.scene.times.length - 1;
      this.slider.max = this.last;
      this.slider.value = Math.floor(this.last * 0.6);
      this.canvas = root.querySelector("canvas");
      this.look = this.scene.view;
      const { low, high, grippers, table } = this.scene;
      const box = [0, 1, 2, 3, 4, 5, 6, 7].map((n) =>
        low.map((l, k) => ((n >> k) & 1 ? high[k] : l)));
      box.push(...grippers.flat());
      const [from, to] = [Math.min, Math.max].map((best) =>
        [0, 1].map((k) => box.reduce((m, p) => best(m, p[k]), box[0][k])));
      const more = 0.15 * Math.max(to[0] - from[0], to[1] - from[1]);
      const [x, y] = [0, 1].map((k) => [from[k] - more, to[k] + more]);
      this.table = table === null ? []
        : [[0, 0], [1, 0], [1, 1], [0, 1]].map(([i, j]) => [x[i], y[j], table]);
      this.shown = [...box, ...this.table]; // at all times [m]
      this.listen();
      root.hidden = false;
      this.draw();
    }

    capsule(t, c) {
      return [0, 3].map((n) =>
        [0, 1, 2].map((k) => this.scene.arm.ends[t][6 * c + n + k] / 1000));
    }

    listen() {
      const { canvas, look } = this;
      this.play.addEventListener("click", () => (this.timer ? this.stop() : this.start()));
      this.slider.addEventListener("input", () => { this.stop(); this.draw(); });
      for (const input of [...this.layers, this.fade].filter(Boolean)) {
        input.addEventListener("input", () => this.draw());
      }
      const turnBy = (right, up) => {
        look.turn += right;
        look.tilt = Math.min(Math.PI / 2, Math.max(0, look.tilt + up));
        this.draw();
      };
      canvas.addEventListener("pointerdown", (e) => canvas.setPointerCapture(e.pointerId));
      canvas.addEventListener("pointermove", (e) => {
        if (e.buttons) turnBy(-0.01 * e.movementX, 0.01 * e.movementY);
      });
      canvas.addEventListener("keydown", (e) => {
        const step = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, 0.1],
          ArrowDown: [0, -0.1] }[e.key];
        if (!step) return;
        e.preventDefault();
        turnBy(...step);
      });
      new ResizeObserver(() => this.draw()).observe(this.root);
      matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
    }

    start() {
      const { times } = this.scene;
      if (Number(this.slider.value) === this.last) this.slider.value = 0;
      this.play.textContent = "Pause";
      let [before, time] = [null, times[Number(this.slider.value)]];
      const step = (now) => {
        if (before !== null) time += ((now - before) / 1000) * Number(this.speed.value);
        before = now;
        // a second to look at the end
        if (time > times[this.last] + Number(this.speed.value)) time = times[0];
        const frame = times.findLastIndex((t) => t <= time);
        if (frame !== Number(this.slider.value)) {
          this.slider.value = frame;
          this.draw();
        }
        this.timer = requestAnimationFrame(step);
      };
      this.timer = requestAnimationFrame(step);
    }

    stop() {
      cancelAnimationFrame(this.timer);
      this.timer = null;
      this.play.textContent = "Play";
    }

    shows(layer) {
      const box = this.layers.find((l) => l.dataset.layer === layer);
      return box ? box.checked : true;
    }

    draw() {
      const t = Number(this.slider.value);
      const { scene } = this;
      this.paint(t);
      const distance = scene.distance === null ? ""
        : ` · ${scene.distance[0]} ${(1000 * scene.distance[1][t]).toFixed(1)} mm`;
      this.clock.textContent =
        `${scene.times[t].toFixed(2)} s · frame ${scene.frames[t]} of ${scene.of}${distance}`;
      this.slider.setAttribute("aria-valuetext", this.clock.textContent);
    }

    paint(t) {
      const { canvas, look, table, shown } = this;
      const [width, height] = [canvas.clientWidth, canvas.clientHeight];
      if (!width || !height) return;
      const ratio = window.devicePixelRatio || 1;
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
      const pen = canvas.getContext("2d");
      pen.scale(ratio, ratio);
      const project = projection(look);
      const flat = shown.map(project);
      const [low, high] = [Math.min, Math.max].map((best) =>
        [0, 1].map((k) => flat.reduce((m, p) => best(m, p[k]), flat[0][k])));
      const scale = Math.min(...[width, height].map((n, k) =>
        (0.86 * n) / Math.max(high[k] - low[k], 1e-3)));
      const place = (p) => {
        const [x, y, depth] = project(p);
        return [width / 2 + scale * (x - (low[0] + high[0]) / 2),
          height / 2 - scale * (y - (low[1] + high[1]) / 2), depth];
      };
      pen.fillStyle = color("table");
      pen.strokeStyle = color("soft");
      if (table.length) line(pen, [...table, table[0]].map(place));
      pen.fill();
      if (this.shows("arm")) this.arm(pen, t, place, scale);
      const fade = this.fade ? Number(this.fade.value) : 0;
      for (const cloud of this.scene.clouds) {
        const share = Math.min(1, cloud.kind === "recorded" ? 1 - fade : 1 + fade);
        if (!this.shows(cloud.kind) || share <= 0) continue;
        pen.globalAlpha = share * (fade && share === 1 ? 1 : OPACITY[cloud.kind]);
        this.cloud(pen, cloud, t, place, width);
        pen.globalAlpha = 1;
      }
      this.marks(pen, t, place);
      this.bar(pen, scale, height);
    }

    // A bar of a round length.
    bar(pen, scale, height) {
      const most = 110 / scale, power = 10 ** Math.floor(Math.log10(most));
      const length = [5, 2, 1].map((m) => m * power).find((l) => l <= most);
      pen.fillStyle = pen.strokeStyle = color("soft");
      pen.lineWidth = 2;
      line(pen, [[12, height - 12], [12 + scale * length, height - 12]]);
      pen.font = `12px ${getComputedStyle(document.body).fontFamily}`;
      const text = length < 1 ? `${Number((1000 * length).toPrecision(3))} mm` : `${length} m`;
      pen.fillText(text, 12, height - 18);
    }

    arm(pen, t, place, scale) {
      const { arm } = this.scene;
      const capsules = arm ? arm.radius.map((r, c) => ({ r, ends: this.capsule(t, c).map(place) }))
        : [];
      const depth = ({ ends }) => ends[0][2] + ends[1][2];
      capsules.sort((p, q) => depth(q) - depth(p));
      pen.lineCap = "round";
      for (const { r, ends: [a, [x, y]] } of capsules) {
        for (const [name, less] of [["arm-edge", 0], ["arm", 2]]) {
          pen.strokeStyle = color(name);
          pen.lineWidth = Math.max(1, (2 * r * scale) / 1000 - less);
          line(pen, [a, [x + 1e-3, y]]); // a line without length is not drawn
        }
      }
    }

    // All dots are one path: where they lie over each other it is as transparent as anywhere.
    cloud(pen, { kind, size, frames }, t, place, width) {
      const r = (size / 2) * Math.min(1.4, Math.max(0.8, width / 450));
      pen.fillStyle = color(kind);
      pen.beginPath();
      for (let i = 0; i < frames[t].length; i += 3) {
        const [x, y] = place(frames[t].slice(i, i + 3).map((c) => c / 1e4));
        pen.moveTo(x + r, y);
        pen.arc(x, y, r, 0, 7);
      }
      pen.fill();
    }

    marks(pen, t, place) {
      for (const [x, y] of (this.scene.grippers[t] || []).map(place)) {
        for (const [name, lineWidth] of [["paper", 4.4], ["ink", 2]]) {
          pen.lineWidth = lineWidth;
          pen.strokeStyle = color(name);
          for (const s of [-5, 5]) line(pen, [[x - 5, y - s], [x + 5, y + s]]);
        }
      }
      const { goal } = this.scene;
      if (goal === null || !this.shows("goal")) return;
      pen.strokeStyle = color("goal");
      pen.lineWidth = 2;
      const [[x, y], ...others] = goal.map(place);
      if (others.length) {
        pen.setLineDash([6, 4]);
        line(pen, [[x, y], ...others]);
        pen.setLineDash([]);
        return;
      }
      pen.beginPath();
      pen.arc(x, y, 9, 0, 7);
      pen.stroke();
      line(pen, [[x - 14, y], [x + 14, y]]);
      line(pen, [[x, y - 14], [x, y + 14]]);
    }
  }

  for (const root of document.querySelectorAll(".viewer")) new Viewer(root);
  addEventListener("beforeprint", () => {
    for (const folded of document.querySelectorAll("details")) folded.open = true;
  });
})();
