// Plays layers of dots, lines and surfaces in a view that turns. Points are in tenths of a millimetre.
(() => {
  const probe = document.body.appendChild(document.createElement("i"));
  probe.hidden = true;

  // A colour of the style sheet as a canvas takes it.
  function named(name) {
    probe.style.color = `var(--${name})`;
    return getComputedStyle(probe).color;
  }

  // Parallel, z up; as `gendom.viz.animation.axes_of`: right, up, away from the eye.
  function projection({ turn, tilt }) {
    const [c, s, ct, st] = [Math.cos(turn), Math.sin(turn), Math.cos(tilt), Math.sin(tilt)];
    return (x, y, z) => {
      const ahead = c * y - s * x;
      return [c * x + s * y, st * ahead + ct * z, ct * ahead - st * z];
    };
  }

  function path(pen, points) {
    pen.beginPath();
    points.forEach((p, k) => pen[k ? "lineTo" : "moveTo"](p[0], p[1]));
  }

  class Player {
    constructor(root) {
      this.root = root;
      this.play = root.querySelector("button.play");
      this.slider = root.querySelector("input.time");
      this.speed = root.querySelector("select.speed");
      this.clock = root.querySelector("output");
      this.options = root.querySelector(".options");
      this.canvas = root.querySelector("canvas");
      const scene = JSON.parse(document.getElementById(root.dataset.scene).textContent);
      Object.assign(this, { look: { ...scene.view, near: 1 }, box: scene.box, hidden: new Set() });
      root.hidden = false;
      this.show(scene, scene.times[Math.floor((scene.times.length - 1) * 0.6)]);
      this.listen();
    }

    // A scene in place of another one, at the same time and from the same place.
    show(scene, time = this.scene.times[Number(this.slider.value)]) {
      this.scene = scene;
      this.last = this.slider.max = scene.times.length - 1;
      this.slider.value = Math.max(scene.times.findLastIndex((t) => t <= time), 0);
      this.options.replaceChildren(...scene.layers.map(({ name, color }) => {
        const label = document.createElement("label"), key = document.createElement("i");
        const box = Object.assign(document.createElement("input"),
          { type: "checkbox", ariaLabel: name, checked: !this.hidden.has(name) });
        key.className = "key dot";
        key.style.setProperty("--c", color);
        box.addEventListener("input", () => {
          this.hidden[box.checked ? "delete" : "add"](name);
          this.draw();
        });
        label.append(box, key, name);
        return label;
      }));
      this.draw();
    }

    listen() {
      const { canvas, look } = this;
      this.play.addEventListener("click", () => (this.timer ? this.stop() : this.start()));
      this.slider.addEventListener("input", () => { this.stop(); this.draw(); });
      const turnBy = (right, up, nearer = 1) => {
        look.turn += right;
        look.near *= nearer;
        look.tilt = Math.min(Math.PI / 2, Math.max(0, look.tilt + up));
        this.draw();
      };
      canvas.addEventListener("pointerdown", (e) => canvas.setPointerCapture(e.pointerId));
      canvas.addEventListener("pointermove", (e) => {
        if (e.buttons) turnBy(-0.01 * e.movementX, 0.01 * e.movementY);
      });
      canvas.addEventListener("keydown", (e) => {
        const step = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, 0.1],
          ArrowDown: [0, -0.1], "+": [0, 0, 1.1], "-": [0, 0, 1 / 1.1] }[e.key];
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

    draw() {
      const t = Number(this.slider.value);
      const { times, frames, of, distance } = this.scene;
      this.paint(t);
      const off = distance === null ? ""
        : ` · ${distance[0]} ${(1000 * distance[1][t]).toFixed(1)} mm`;
      this.clock.textContent = `${times[t].toFixed(2)} s · frame ${frames[t]} of ${of}${off}`;
      this.slider.setAttribute("aria-valuetext", this.clock.textContent);
    }

    paint(t) {
      const { canvas, look, scene } = this;
      const [width, height] = [canvas.clientWidth, canvas.clientHeight];
      if (!width || !height) return;
      const ratio = window.devicePixelRatio || 1;
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
      const pen = canvas.getContext("2d");
      pen.scale(ratio, ratio);
      const project = projection(look);
      const flat = this.box.map((p) => project(...p));
      const [low, high] = [Math.min, Math.max].map((best) =>
        [0, 1].map((k) => flat.reduce((m, p) => best(m, p[k]), flat[0][k])));
      const scale = Math.min(...[width, height].map((n, k) =>
        (0.86 * look.near * n) / Math.max(high[k] - low[k], 10)));
      const place = (x, y, z) => {
        const [right, up, away] = project(x, y, z);
        return [width / 2 + scale * (right - (low[0] + high[0]) / 2),
          height / 2 - scale * (up - (low[1] + high[1]) / 2), away];
      };
      pen.fillStyle = named("table");
      pen.strokeStyle = named("soft");
      if (scene.table.length) {
        path(pen, scene.table.map((p) => place(...p)));
        pen.closePath();
        pen.stroke();
        pen.fill();
      }
      const shown = scene.layers.filter((layer) => !this.hidden.has(layer.name)).map((layer) => {
        const points = layer.frames[layer.frames.length > 1 ? t : 0], seen = [];
        for (let i = 0; i < points.length; i += 3) seen.push(place(...points.slice(i, i + 3)));
        return { ...layer, color: layer.ink ? named("ink") : layer.color, points, seen };
      });
      const shapes = shown.flatMap((layer) => this.shapes(layer, scale));
      shapes.sort((a, b) => b.away - a.away);
      pen.lineCap = "round";
      for (const { color, corners, wide } of shapes) {
        pen.fillStyle = pen.strokeStyle = color;
        pen.lineWidth = wide;
        path(pen, corners);
        if (corners.length > 2) pen.fill();
        pen.stroke();
      }
      for (const layer of shown) if (layer.kind === "dots") this.dots(pen, layer, scale);
      this.bar(pen, scale, height);
    }

    // Lines, and triangles with light on them; of what is closed, the back is hidden.
    shapes({ kind, color, seen, points, faces, closed, radius }, scale) {
      if (kind === "lines") {
        return radius.map((r, k) => {
          const [a, [x, y, away]] = seen.slice(2 * k, 2 * k + 2);
          // a line without length is not drawn
          return { color, corners: [a, [x + 1e-3, y]], wide: Math.max(2 * r * scale, 1.5),
            away: (a[2] + away) / 2 };
        });
      }
      const found = [], channels = [1, 3, 5].map((k) => parseInt(color.slice(k, k + 2), 16));
      for (let i = 0; kind === "surface" && i < faces.length; i += 3) {
        const corners = faces.slice(i, i + 3), [a, b, c] = corners.map((k) => seen[k]);
        const area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        if (closed && area > 0) continue;
        const [p, q, r] = corners.map((k) => points.slice(3 * k, 3 * k + 3));
        const [u, v] = [q, r].map((o) => o.map((x, k) => x - p[k]));
        const n = [0, 1, 2].map((k) =>
          u[(k + 1) % 3] * v[(k + 2) % 3] - u[(k + 2) % 3] * v[(k + 1) % 3]);
        const lit = Math.abs(0.3 * n[0] - 0.5 * n[1] + 0.8 * n[2]) / (Math.hypot(...n) || 1);
        const shade = channels.map((x) => Math.round((0.55 + 0.45 * lit) * x));
        // a sheet lies over the solid that it touches
        const away = (closed ? Math.max : Math.min)(a[2], b[2], c[2]);
        found.push({ color: `rgb(${shade})`, corners: [a, b, c, a], wide: 0.5, away });
      }
      return found;
    }

    // All dots are one path: where they lie over each other it is as transparent as anywhere.
    dots(pen, { color, opacity, radius, seen }, scale) {
      const r = Math.max(radius[0] * scale, 1.1);
      pen.globalAlpha = opacity;
      pen.fillStyle = color;
      pen.beginPath();
      for (const [x, y] of seen) {
        pen.moveTo(x + r, y);
        pen.arc(x, y, r, 0, 7);
      }
      pen.fill();
      pen.globalAlpha = 1;
    }

    // A bar of a round length.
    bar(pen, scale, height) {
      const most = 11 / scale, power = 10 ** Math.floor(Math.log10(most));
      const length = [5, 2, 1].map((m) => m * power).find((l) => l <= most); // [mm]
      pen.fillStyle = pen.strokeStyle = named("soft");
      pen.lineWidth = 2;
      path(pen, [[12, height - 12], [12 + 10 * scale * length, height - 12]]);
      pen.stroke();
      pen.font = `12px ${getComputedStyle(this.root).fontFamily}`;
      pen.fillText(length < 1000 ? `${length} mm` : `${length / 1000} m`, 12, height - 18);
    }
  }

  // Sliders and boxes of parameters: what moved is simulated again, and the last wish wins.
  class Parameters {
    constructor(form, player) {
      this.player = player;
      this.said = document.querySelector(".said");
      this.rows = [...form.querySelectorAll("label")].map((label) => {
        const row = JSON.parse(label.dataset.about), [slider, box] = label.querySelectorAll("input");
        const [low, high] = [row.low, row.high].map((x) => (row.log ? Math.log(x) : x));
        row.set = (value) => {
          row.now = value;
          slider.value = ((row.log ? Math.log(value) : value) - low) / (high - low);
          box.value = Number((row.factor * value).toPrecision(4));
        };
        slider.addEventListener("input", () => {
          const at = low + Number(slider.value) * (high - low);
          row.set(row.log ? Math.exp(at) : at);
          this.ask();
        });
        box.addEventListener("change", () => {
          const value = Number(box.value) / row.factor;
          row.set(Number.isFinite(value) ? Math.min(Math.max(value, row.low), row.high) : row.now);
          this.ask();
        });
        row.set(row.value);
        return row;
      });
      form.addEventListener("reset", (e) => {
        e.preventDefault();
        for (const row of this.rows) row.set(row.value);
        this.ask();
      });
      this.ask();
    }

    // One request at a time; one that takes longer than a second is given up for a newer one.
    async ask() {
      this.changed = true;
      if (this.began) {
        if (performance.now() - this.began > 1000) this.giveUp.abort();
        return;
      }
      while (this.changed) {
        Object.assign(this, { changed: false, began: performance.now(), giveUp: new AbortController() });
        const values = Object.fromEntries(this.rows.map(({ name, now }) => [name, now]));
        const asked = { method: "POST", body: JSON.stringify(values), signal: this.giveUp.signal };
        try {
          const reader = (await fetch("simulate", asked)).body
            .pipeThrough(new TextDecoderStream()).getReader();
          let text = "";
          for (let part; !this.changed && !(part = await reader.read()).done;) {
            const lines = (text + part.value).split("\n");
            text = lines.pop();
            for (const line of lines) this.take(JSON.parse(line));
          }
          reader.cancel();
        } catch (error) {
          if (error.name !== "AbortError") this.take({ fault: "the viewer has ended" });
        }
      }
      this.began = null;
    }

    take({ scene, said, fault }) {
      this.said.textContent = fault ?? said;
      this.said.classList.toggle("warning", fault !== undefined);
      if (scene) this.player.show(scene);
    }
  }

  const [first] = [...document.querySelectorAll(".viewer")].map((root) => new Player(root));
  for (const form of document.querySelectorAll(".parameters")) new Parameters(form, first);
  addEventListener("beforeprint", () => {
    for (const folded of document.querySelectorAll("details")) folded.open = true;
  });
})();
