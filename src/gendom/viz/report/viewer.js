// Plays clouds, arm and goal: a film from a fixed side and a view that turns, at one time.
// Points are uint16 in the box `low`..`high` [m], the arm is in millimetres.
(() => {
  const RECORDED_OPACITY = 0.85, SIMULATED_OPACITY = 0.6;
  const NARROW = 520; // pixels: below, clouds side by side stand one above the other
  const probe = document.body.appendChild(document.createElement("i"));
  probe.hidden = true;
  let colors = new Map();
  document.addEventListener("themechange", () => { colors = new Map(); });

  // A colour of the style sheet as a canvas takes it.
  function color(name) {
    if (!colors.has(name)) {
      probe.style.color = `var(--${name})`;
      colors.set(name, getComputedStyle(probe).color);
    }
    return colors.get(name);
  }

  function niceStep(atLeast) {
    const power = 10 ** Math.floor(Math.log10(atLeast));
    return [1, 2, 5, 10].map((m) => m * power).find((s) => s >= atLeast * (1 - 1e-9));
  }

  // Orthographic, z up; as `gendom.viz.clouds.Projection`. Depth grows away from the eye.
  function projection({ turn, tilt }) {
    const [c, s, ct, st] = [Math.cos(turn), Math.sin(turn), Math.cos(tilt), Math.sin(tilt)];
    return ([x, y, z]) => {
      const ahead = c * y - s * x;
      return [c * x + s * y, st * ahead + ct * z, ct * ahead - st * z];
    };
  }

  class Viewer {
    constructor(root) {
      this.root = root;
      this.scene = JSON.parse(document.getElementById(root.dataset.scene).textContent);
      const bytes = Uint8Array.from(atob(this.scene.points), (c) => c.charCodeAt(0));
      this.grid = new DataView(bytes.buffer);
      this.span = this.scene.high.map((h, k) => h - this.scene.low[k]);
      this.film = root.querySelector("canvas.film");
      this.turning = root.querySelector("canvas.turning");
      this.sheet = document.createElement("canvas"); // one cloud at a time, see `cloud`
      this.play = root.querySelector("button.play");
      this.slider = root.querySelector("input.time");
      this.fade = root.querySelector("input.fade");
      this.layout = root.querySelector("select.layout");
      this.speed = root.querySelector("select.speed");
      this.clock = root.querySelector("output");
      this.layers = [...root.querySelectorAll("input[data-layer]")];
      this.cursors = [...document.querySelectorAll(".cursor")].filter(
        (c) => c.dataset.scene === root.dataset.scene,
      );
      this.look = { turn: this.scene.view.turn + this.clearSide(), tilt: 0.3 };
      this.last = this.scene.times.length - 1;
      this.slider.max = this.last;
      this.slider.value = Math.floor(this.last * 0.6);
      this.listen();
      root.hidden = false;
      this.draw();
    }

    listen() {
      this.play.addEventListener("click", () => (this.timer ? this.stop() : this.start()));
      this.slider.addEventListener("input", () => { this.stop(); this.draw(); });
      for (const input of [...this.layers, this.fade, this.layout].filter(Boolean)) {
        input.addEventListener("input", () => this.draw());
      }
      this.turning.addEventListener("pointerdown", (e) =>
        this.turning.setPointerCapture(e.pointerId));
      this.turning.addEventListener("pointermove", (e) => {
        if (e.buttons) this.turnBy(-0.01 * e.movementX, 0.01 * e.movementY);
      });
      this.turning.addEventListener("keydown", (e) => {
        const step = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, 0.1],
          ArrowDown: [0, -0.1] }[e.key];
        if (!step) return;
        e.preventDefault();
        this.turnBy(...step);
      });
      new ResizeObserver(() => this.draw()).observe(this.root);
      document.addEventListener("themechange", () => this.draw());
    }

    // Half a radian to the side from which the arm stands behind the object.
    clearSide() {
      const { arm, view, low, high } = this.scene;
      if (!arm) return 0.5;
      const behind = (side) => {
        const project = projection({ turn: view.turn + side, tilt: 0 });
        const [, , depth] = project(low.map((l, k) => (l + high[k]) / 2));
        const first = arm.ends[0];
        let sum = 0;
        for (let i = 0; i < first.length; i += 3) {
          sum += project([0, 1, 2].map((k) => first[i + k] / 1000))[2] - depth;
        }
        return sum;
      };
      return behind(0.5) >= behind(-0.5) ? 0.5 : -0.5;
    }

    turnBy(right, up) {
      this.look.turn += right;
      this.look.tilt = Math.min(Math.PI / 2, Math.max(0, this.look.tilt + up));
      this.draw();
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
        let frame = times.findIndex((t) => t > time) - 1;
        if (frame < 0) frame = time < times[0] ? 0 : this.last;
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
      const beside = this.layout !== null && this.layout.value === "beside";
      this.root.classList.toggle("beside", beside);
      for (const canvas of [this.film, this.turning]) {
        const [width, height] = [canvas.clientWidth, canvas.clientHeight];
        if (!width || !height) continue;
        const ratio = window.devicePixelRatio || 1;
        canvas.width = Math.round(width * ratio);
        canvas.height = Math.round(height * ratio);
        const pen = canvas.getContext("2d");
        const stacked = width < NARROW;
        const kinds = beside ? scene.clouds.map((c) => c.kind).reverse() : [null];
        kinds.forEach((kind, k) => {
          const w = beside && !stacked ? width / kinds.length : width;
          const h = beside && stacked ? height / kinds.length : height;
          const [x, y] = stacked ? [0, k * h] : [k * w, 0];
          pen.setTransform(ratio, 0, 0, ratio, ratio * x, ratio * y);
          pen.save();
          pen.beginPath();
          pen.rect(0, 0, w, h);
          pen.clip();
          this.panel(pen, w, h, t, canvas === this.film, kind, ratio);
          pen.restore();
          if (k) {
            pen.strokeStyle = color("line");
            pen.lineWidth = 1;
            pen.strokeRect(0, 0, stacked ? w : 0, stacked ? 0 : h);
          }
        });
      }
      const chamfer = scene.chamfer === null ? ""
        : ` · Chamfer ${(1000 * scene.chamfer[t]).toFixed(1)} mm`;
      this.clock.textContent =
        `${scene.times[t].toFixed(2)} s · frame ${scene.frames[t]} of ${scene.of}${chamfer}`;
      this.slider.setAttribute("aria-valuetext", this.clock.textContent);
      for (const cursor of this.cursors) {
        const [low, high, left, right] = ["low", "high", "left", "right"].map(
          (n) => Number(cursor.dataset[n]));
        const at = left + ((right - left) * (scene.times[t] - low)) / (high - low);
        cursor.setAttribute("x1", at);
        cursor.setAttribute("x2", at);
        cursor.setAttribute("visibility", "visible");
      }
    }

    // One picture; `kind` is the only cloud in it, or null.
    panel(pen, width, height, t, isFilm, kind, ratio) {
      const { scene } = this;
      const look = isFilm ? scene.view : this.look;
      const axes = isFilm && scene.view.names !== null;
      const project = projection(look);
      const withArm = !isFilm && scene.arm !== null && this.shows("arm");
      const [low, high] = this.limits(project, withArm, !axes && scene.table !== null);
      const margin = axes ? { left: 44, right: 10, top: 22, bottom: 26 }
        : { left: 10, right: 10, top: 10, bottom: 10 };
      const inner = [width - margin.left - margin.right, height - margin.top - margin.bottom];
      const scale = Math.min(...inner.map((n, k) => n / Math.max(high[k] - low[k], 1e-3)));
      const middle = [0, 1].map((k) => (low[k] + high[k]) / 2);
      const centre = [margin.left + inner[0] / 2, margin.top + inner[1] / 2];
      const put = ([x, y]) =>
        [centre[0] + scale * (x - middle[0]), centre[1] - scale * (y - middle[1])];
      const place = (p) => put(project(p));
      pen.save();
      this.ground(pen, width, height, { axes, withArm, put, place, scale, middle, centre, margin });
      if (this.shows("arm")) this.arm(pen, t, project, put, scale);
      const fade = this.fade ? Number(this.fade.value) : 0;
      for (const cloud of scene.clouds) {
        if (kind !== null && cloud.kind !== kind) continue;
        if (!this.shows(cloud.kind)) continue;
        const recorded = cloud.kind === "recorded";
        const share = Math.min(1, recorded ? 1 - fade : 1 + fade);
        const opacity = kind !== null ? 1 : share * (fade === 0 || share < 1
          ? (recorded ? RECORDED_OPACITY : SIMULATED_OPACITY) : 1);
        this.cloud(pen, cloud, t, place, opacity, width, height, ratio);
      }
      this.marks(pen, t, place);
      pen.restore(); // a film is cut off at its axes
      if (kind !== null) {
        pen.fillStyle = color("ink");
        pen.font = `600 13px ${getComputedStyle(document.body).fontFamily}`;
        pen.textAlign = "right";
        pen.textBaseline = "top";
        pen.fillText(scene.clouds.find((c) => c.kind === kind).label, width - 10, 8);
      }
    }

    // [lowest, highest] right and up of all that is shown, the same at every time.
    limits(project, withArm, withTable) {
      const { scene } = this;
      const corners = [];
      if (withTable) {
        const [[x0, y0], [x1, y1]] = this.tabletop(withArm);
        for (const x of [x0, x1]) for (const y of [y0, y1]) {
          corners.push(project([x, y, scene.table]));
        }
      }
      const box = [scene.low, scene.high].map((c) => [...c]);
      if (scene.table !== null) box[0][2] = Math.min(box[0][2], scene.table);
      for (const x of [0, 1]) for (const y of [0, 1]) for (const z of [0, 1]) {
        corners.push(project([box[x][0], box[y][1], box[z][2]]));
      }
      for (const frame of scene.grippers) corners.push(...frame.map(project));
      if (withArm) {
        const { radius, ends } = scene.arm;
        ends.forEach((frame) => {
          for (let i = 0; i < frame.length; i += 3) {
            const [x, y] = project([0, 1, 2].map((k) => frame[i + k] / 1000));
            const r = radius[Math.floor(i / 6)] / 1000;
            corners.push([x - r, y - r], [x + r, y + r]);
          }
        });
      }
      const low = [0, 1].map((k) => corners.reduce((m, c) => Math.min(m, c[k]), Infinity));
      const high = [0, 1].map((k) => corners.reduce((m, c) => Math.max(m, c[k]), -Infinity));
      const pad = 0.05 * Math.max(high[0] - low[0], high[1] - low[1]);
      // what holds the object stands above it
      const above = scene.arm && !withArm ? 0.12 * (high[1] - low[1]) : 0;
      return [low.map((v) => v - pad), [high[0] + pad, high[1] + pad + above]];
    }

    // [lowest, highest] x and y of the piece of table that is drawn.
    tabletop(withArm) {
      const more = 0.15 * Math.max(this.span[0], this.span[1]);
      const ends = [0, 1].map((k) => [this.scene.low[k] - more, this.scene.high[k] + more]);
      if (withArm) {
        for (const frame of this.scene.arm.ends) {
          frame.forEach((value, i) => {
            if (i % 3 === 2) return;
            const end = ends[i % 3];
            end[0] = Math.min(end[0], value / 1000 - more);
            end[1] = Math.max(end[1], value / 1000 + more);
          });
        }
      }
      return [0, 1].map((n) => ends.map((end) => end[n]));
    }

    // The table, and the axes of a film from the side.
    ground(pen, width, height, { axes, withArm, put, place, scale, middle, centre, margin }) {
      const { scene } = this;
      if (axes) {
        const upright = scene.view.names[1] === "z";
        if (upright && scene.table !== null) {
          const [, y] = put([0, scene.table]);
          pen.fillStyle = color("table");
          pen.fillRect(margin.left, y, width - margin.left - margin.right,
            Math.max(0, height - margin.bottom - y));
          pen.fillStyle = color("soft");
          pen.fillRect(margin.left, y, width - margin.left - margin.right, 1.5);
        }
        const inMillimetres = Math.max(width, height) / scale < 1.5;
        const [factor, unit] = inMillimetres ? [1000, "mm"] : [1, "m"];
        pen.font = `11px ${getComputedStyle(document.body).fontFamily}`;
        pen.lineWidth = 1;
        const name = `${scene.view.names[0]} [${unit}]`;
        const free = width - 16 - pen.measureText(name).width; // the axis's name stands there
        const written = (v) => String(Number((v * factor).toPrecision(6))).replace("-", "−");
        for (const axis of [0, 1]) {
          const [from, to] = axis === 0 ? [margin.left, width - margin.right]
            : [height - margin.bottom, margin.top];
          const at = (pixel) => middle[axis] + ((pixel - centre[axis]) / scale) * (axis ? -1 : 1);
          const [first, last] = [at(from), at(to)];
          const step = niceStep((last - first) / (axis === 0 ? width / 70 : height / 45));
          for (let v = Math.ceil(first / step) * step; v <= last + 1e-9; v += step) {
            const [x, y] = put([v, v]);
            pen.strokeStyle = color("grid");
            pen.fillStyle = color("soft");
            pen.beginPath();
            if (axis === 0) {
              pen.moveTo(x, margin.top);
              pen.lineTo(x, height - margin.bottom);
              [pen.textAlign, pen.textBaseline] = ["center", "top"];
              if (x + pen.measureText(written(v)).width / 2 < free) {
                pen.fillText(written(v), x, height - margin.bottom + 6);
              }
            } else {
              pen.moveTo(margin.left, y);
              pen.lineTo(width - margin.right, y);
              [pen.textAlign, pen.textBaseline] = ["right", "middle"];
              if (y > margin.top) pen.fillText(written(v), margin.left - 6, y);
            }
            pen.stroke();
          }
        }
        [pen.textAlign, pen.textBaseline] = ["right", "top"];
        pen.fillText(name, width - 8, height - margin.bottom + 6);
        pen.textAlign = "left";
        pen.fillText(`${scene.view.names[1]} [${unit}]`, 6, 5);
        pen.beginPath();
        pen.rect(margin.left, margin.top, width - margin.left - margin.right,
          height - margin.top - margin.bottom);
        pen.clip();
      } else if (scene.table !== null) {
        const [[x0, y0], [x1, y1]] = this.tabletop(withArm);
        const corners = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]];
        pen.beginPath();
        corners.forEach(([x, y], k) => pen[k ? "lineTo" : "moveTo"](...place([x, y, scene.table])));
        pen.closePath();
        pen.fillStyle = color("table");
        pen.fill();
        pen.lineWidth = 1;
        pen.strokeStyle = color("soft");
        pen.stroke();
      }
    }

    arm(pen, t, project, put, scale) {
      if (!this.scene.arm) return;
      const { radius, ends } = this.scene.arm;
      const capsules = radius.map((r, c) => {
        const [a, b] = [0, 3].map((n) =>
          project([0, 1, 2].map((k) => ends[t][6 * c + n + k] / 1000)));
        return { a: put(a), b: put(b), depth: a[2] + b[2], width: (2 * r * scale) / 1000 };
      });
      capsules.sort((p, q) => q.depth - p.depth);
      pen.lineCap = "round";
      for (const { a, b, width } of capsules) {
        for (const [name, less] of [["arm-edge", 0], ["arm", 2]]) {
          pen.strokeStyle = color(name);
          pen.lineWidth = Math.max(1, width - less);
          pen.beginPath();
          pen.moveTo(...a);
          pen.lineTo(b[0] + 1e-3, b[1]); // a line without length is not drawn
          pen.stroke();
        }
      }
    }

    // Dots of one cloud are painted opaque on a sheet of their own, and the sheet is laid over the
    // picture: where dots lie over each other the cloud is as transparent as anywhere.
    cloud(pen, cloud, t, place, opacity, width, height, ratio) {
      if (opacity <= 0) return;
      const { sheet, grid, scene, span } = this;
      sheet.width = Math.ceil(width * ratio);
      sheet.height = Math.ceil(height * ratio);
      const brush = sheet.getContext("2d");
      brush.scale(ratio, ratio);
      brush.fillStyle = color(cloud.kind);
      const r = (cloud.size / 2) * Math.min(1.4, Math.max(0.8, width / 450));
      brush.beginPath();
      for (let i = cloud.offsets[t]; i < cloud.offsets[t + 1]; i++) {
        const [x, y] = place([0, 1, 2].map(
          (k) => scene.low[k] + (span[k] * grid.getUint16(6 * i + 2 * k, true)) / 65535));
        brush.moveTo(x + r, y);
        brush.arc(x, y, r, 0, 7);
      }
      brush.fill();
      pen.globalAlpha = opacity;
      pen.drawImage(sheet, 0, 0, width, height);
      pen.globalAlpha = 1;
    }

    marks(pen, t, place) {
      pen.lineCap = "round";
      for (const gripper of this.scene.grippers[t] || []) {
        const [[x, y], r] = [place(gripper), 5];
        for (const [name, lineWidth] of [["paper", 4.4], ["ink", 2]]) {
          pen.lineWidth = lineWidth;
          pen.strokeStyle = color(name);
          pen.beginPath();
          for (const s of [-1, 1]) {
            pen.moveTo(x - r, y - s * r);
            pen.lineTo(x + r, y + s * r);
          }
          pen.stroke();
        }
      }
      const { goal } = this.scene;
      if (goal === null || !this.shows("goal")) return;
      const places = goal.map(place);
      pen.strokeStyle = color("goal");
      pen.fillStyle = color("goal");
      pen.lineWidth = 2;
      pen.beginPath();
      if (places.length === 1) {
        const [[x, y]] = places;
        pen.arc(x, y, 9, 0, 7);
        pen.moveTo(x - 14, y);
        pen.lineTo(x + 14, y);
        pen.moveTo(x, y - 14);
        pen.lineTo(x, y + 14);
      } else {
        pen.setLineDash([6, 4]);
        places.forEach((p, k) => pen[k ? "lineTo" : "moveTo"](...p));
      }
      pen.stroke();
      pen.setLineDash([]);
    }
  }

  for (const root of document.querySelectorAll(".viewer")) new Viewer(root);
})();
