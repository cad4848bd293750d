// Clouds of all frames that can be turned: points are uint16 in the box `low`..`high`.
(() => {
  const viewer = document.getElementById("viewer");
  if (!viewer) return;
  const scene = JSON.parse(document.getElementById("scene").textContent);
  const bytes = Uint8Array.from(atob(scene.points), (c) => c.charCodeAt(0));
  const grid = new DataView(bytes.buffer);
  const span = scene.high.map((h, i) => h - scene.low[i]);
  const middle = scene.low.map((l, i) => l + span[i] / 2);
  const canvas = viewer.querySelector("canvas");
  const [play, slider, clock] = ["button", "input", "output"].map((n) => viewer.querySelector(n));
  const pen = canvas.getContext("2d");
  let [turn, tilt] = [0.5, 0.35];
  let timer = null;
  slider.max = scene.times.length - 1;

  function draw() {
    const t = Number(slider.value);
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    canvas.width = width * ratio;
    canvas.height = height * ratio;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    const [c, s, ct, st] = [Math.cos(turn), Math.sin(turn), Math.cos(tilt), Math.sin(tilt)];
    const scale = Math.min(width, 1.2 * height) / (1.1 * Math.hypot(...span));
    const place = ([x, y, z]) => {
      const [dx, dy, dz] = [x - middle[0], y - middle[1], z - middle[2]];
      return [
        width / 2 + scale * (c * dx + s * dy),
        height / 2 - scale * (st * (c * dy - s * dx) + ct * dz),
      ];
    };
    const path = (corners, close) => {
      pen.beginPath();
      corners.forEach((p, i) => pen[i ? "lineTo" : "moveTo"](...place(p)));
      if (close) pen.closePath();
    };
    if (scene.table !== null) {
      const [[x0, y0], [x1, y1], z] = [scene.low, scene.high, scene.table];
      path([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]], true);
      pen.fillStyle = "#f4f4f4";
      pen.fill();
      pen.lineWidth = 1.5;
      pen.strokeStyle = "#969696";
      pen.stroke();
    }
    for (const cloud of scene.clouds) {
      pen.fillStyle = cloud.color;
      for (let i = cloud.offsets[t]; i < cloud.offsets[t + 1]; i++) {
        const at = [0, 1, 2].map(
          (k) => scene.low[k] + (span[k] * grid.getUint16(6 * i + 2 * k, true)) / 65535
        );
        const [x, y] = place(at);
        pen.fillRect(x - cloud.size / 2, y - cloud.size / 2, cloud.size, cloud.size);
      }
    }
    pen.lineWidth = 2.2;
    pen.strokeStyle = "#222";
    for (const gripper of scene.grippers[t] || []) {
      const [x, y] = place(gripper);
      pen.beginPath();
      pen.moveTo(x - 6, y - 6);
      pen.lineTo(x + 6, y + 6);
      pen.moveTo(x - 6, y + 6);
      pen.lineTo(x + 6, y - 6);
      pen.stroke();
    }
    clock.textContent = scene.times[t].toFixed(2) + " s";
  }

  function stop() {
    clearInterval(timer);
    timer = null;
    play.textContent = "Play";
  }
  play.addEventListener("click", () => {
    if (timer !== null) return stop();
    play.textContent = "Pause";
    timer = setInterval(() => {
      slider.value = (Number(slider.value) + 1) % scene.times.length;
      draw();
    }, 1000 / scene.fps);
  });
  slider.addEventListener("input", () => { stop(); draw(); });
  canvas.addEventListener("pointerdown", (e) => canvas.setPointerCapture(e.pointerId));
  canvas.addEventListener("pointermove", (e) => {
    if (!e.buttons) return;
    turn -= 0.01 * e.movementX;
    tilt = Math.min(Math.PI / 2, Math.max(0, tilt + 0.01 * e.movementY));
    draw();
  });
  window.addEventListener("resize", draw);
  viewer.hidden = false;
  slider.value = Math.floor(scene.times.length * 0.6);
  draw();
})();
