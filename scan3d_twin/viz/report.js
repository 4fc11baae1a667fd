// The model of the page: what is shown, how it is turned, and measured. Without WebGL, and when the
// browser takes it away, the page shows its still picture.
"use strict";
(() => {
  const read = (id) => document.getElementById(id).textContent.trim();
  const decode = (id) => Uint8Array.from(atob(read(id)), (letter) => letter.charCodeAt(0));
  const meta = JSON.parse(read("meta")), bytes = decode("cloud");
  const faces = new Uint32Array(decode("faces").buffer);
  const box = document.getElementById("model"), canvas = box.querySelector("canvas");
  const find = (id) => document.getElementById(id);
  const controls = find("controls"), boxes = [...controls.querySelectorAll("input[data-view]")];
  const camera = makeCamera(meta.camera, canvas);

  // What is wanted, from the controls
  const measured = [];
  const wanted = () => {
    const colouring = find("colouring").value, axis = "xyz".indexOf(find("axis").value);
    const share = Number(find("cut").value), normal = [0, 0, 0];
    if (axis >= 0) normal[axis] = 1;
    return {
      upto: Number(find("upto").value), views: boxes.map((each) => each.checked),
      ...Object.fromEntries(["points", "mesh", "around", "missing"].map((id) => [id, Boolean(find(id)?.checked)])),
      byHeight: colouring === "height", value: meta.values.findIndex((each) => each.name === colouring),
      section: { normal, cut: axis < 0 ? 1 : meta.box[0][axis] + share * (meta.box[1][axis] - meta.box[0][axis]) },
      measured,
    };
  };

  // Draw, and tell what is drawn
  let paint = null, waiting = 0;
  const draw = () => { waiting ||= requestAnimationFrame(redraw); };
  const words = (metres) => (metres < 1 ? `${Math.round(1000 * metres)} mm` : `${metres.toFixed(3)} m`);
  const tellLegend = (now) => {
    const each = meta.values[now.value], shown = Boolean(each || now.byHeight);
    const [low, high, unit] = each ? [each.low, each.high, each.unit] : [...meta.heights, "m"];
    find("legend").hidden = !shown;
    if (!shown) return;
    find("low").textContent = `${Number(low.toFixed(2))}`;
    find("high").textContent = `${each ? Number(high.toFixed(1)) : high.toFixed(2)} ${unit}`.trim();
  };
  const tellScale = () => {
    const metres = 90 * camera.metresPerPixel(), power = 10 ** Math.floor(Math.log10(metres));
    const length = [5, 2, 1].map((factor) => factor * power).find((each) => each <= metres);
    find("bar").style.width = `${length / camera.metresPerPixel()}px`;
    find("length").textContent = length >= 1 ? `${length} m` : `${Number((100 * length).toPrecision(1))} cm`;
  };
  const tellMeasured = () => {
    const label = find("distance");
    label.hidden = measured.length < 1;
    if (!measured.length) return;
    const places = measured.map((place) => camera.project(place));
    const middle = [0, 1].map((i) => places.reduce((sum, place) => sum + place[i], 0) / places.length);
    label.style.left = `${middle[0]}px`;
    label.style.top = `${middle[1]}px`;
    if (measured.length < 2) { label.textContent = "and the other end"; return; }
    const [a, b] = measured, along = a.map((v, i) => Math.abs(v - b[i]));
    label.textContent = `${words(Math.hypot(...along))} (x ${words(along[0])}, y ${words(along[1])}, z ${words(along[2])})`;
  };
  function redraw() {
    waiting = 0;
    if (!paint) return;
    const now = wanted(), count = meta.colours.length;
    paint(now, camera);
    find("shown").textContent = now.upto + 1 === count ? `all ${count}` : `${now.upto + 1} of ${count}`;
    find("cut").disabled = find("axis").value === "none";
    tellLegend(now);
    tellScale();
    tellMeasured();
  }

  // Begin, and begin again when the browser has taken the drawing away
  const begin = () => {
    paint = makeDrawing(canvas, meta, bytes, faces);
    for (const each of [box, controls]) each.classList.toggle("drawn", Boolean(paint));
    if (paint) redraw();
  };
  canvas.addEventListener("webglcontextlost", (event) => {
    event.preventDefault();
    paint = null;
    for (const each of [box, controls]) each.classList.remove("drawn");
  });
  canvas.addEventListener("webglcontextrestored", begin);

  // Measure between the shown points nearest to two clicks: 2 cm nearer the eye count as a pixel
  const pick = (x, y) => {
    const now = wanted(), { normal, cut } = now.section, matrix = camera.matrix();
    let best = null, lowest = Infinity;
    meta.ranges.views.forEach((range, k) => {
      if (!now.views[k] || k > now.upto) return;
      const places = placesOf(meta, bytes, range);
      for (let j = 0; j < places.length; j += 3) {
        const place = [places[j], places[j + 1], places[j + 2]];
        if (normal[0] * place[0] + normal[1] * place[1] + normal[2] * place[2] > cut) continue;
        const [column, row, depth] = camera.project(place, matrix);
        const off = Math.hypot(column - x, row - y), cost = off + 50 * depth;
        if (depth > 0.02 && off < 14 && cost < lowest) [best, lowest] = [place, cost];
      }
    });
    return best;
  };
  const measure = find("measure");
  const measureAt = (event) => {
    const frame = canvas.getBoundingClientRect();
    const place = pick(event.clientX - frame.left, event.clientY - frame.top);
    if (!place) return;
    if (measured.length === 2) measured.length = 0;
    measured.push(place);
    draw();
  };
  measure.addEventListener("click", () => {
    measured.length = 0;
    const on = measure.getAttribute("aria-pressed") !== "true";
    measure.setAttribute("aria-pressed", on);
    canvas.style.cursor = on ? "crosshair" : "";
    draw();
  });

  // Turn, move and zoom by pointer, wheel and keys
  const fingers = new Map();
  let moved = 0;
  const spread = () => {
    const [a, b] = [...fingers.values()];
    return Math.hypot(a.x - b.x, a.y - b.y);
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    canvas.focus({ preventScroll: true });
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    moved = 0;
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const dx = event.clientX - before.x, dy = event.clientY - before.y;
    const wide = fingers.size > 1 ? spread() : 0;
    moved += Math.abs(dx) + Math.abs(dy);
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    if (fingers.size > 1) {
      camera.zoom(wide / Math.max(1, spread()));
      camera.slide(dx / 2, dy / 2);
    } else if (event.shiftKey || event.buttons === 2) camera.slide(dx, dy);
    else camera.turn(dx, dy);
    draw();
  });
  canvas.addEventListener("pointerup", (event) => {
    fingers.delete(event.pointerId);
    if (moved < 5 && measure.getAttribute("aria-pressed") === "true") measureAt(event);
  });
  canvas.addEventListener("pointercancel", (event) => fingers.delete(event.pointerId));
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  // The wheel scrolls the page until the model was clicked.
  canvas.addEventListener("wheel", (event) => {
    if (document.activeElement !== canvas) return;
    event.preventDefault();
    camera.zoom(Math.exp(0.001 * event.deltaY));
    draw();
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-20, 0], ArrowRight: [20, 0], ArrowUp: [0, -20], ArrowDown: [0, 20] }[event.key];
    if (step) camera.turn(...step);
    else if (event.key === "+") camera.zoom(0.9);
    else if (event.key === "-") camera.zoom(1.1);
    else return;
    event.preventDefault();
    draw();
  });
  const back = () => { camera.reset(); draw(); };
  canvas.addEventListener("dblclick", back);
  find("reset").addEventListener("click", back);
  controls.addEventListener("input", draw);
  new ResizeObserver(draw).observe(canvas);

  // Give files back
  const topView = document.querySelector("#top-view");
  const svg = () => [Uint8Array.from(atob(topView.src.split(",")[1]), (letter) => letter.charCodeAt(0))];
  const files = {
    ply: ["model.ply", "application/octet-stream", () => makePly(meta, bytes)],
    e57: ["model.e57", "application/octet-stream", () => makeE57(meta, bytes)],
    glb: ["mesh.glb", "model/gltf-binary", () => makeGlb(meta, bytes, faces)],
    json: ["report.json", "application/json", () => [read("report")]],
    svg: ["top_view.svg", "image/svg+xml", svg],
  };
  if (!topView) document.querySelector("button[data-file=svg]").remove();
  for (const button of document.querySelectorAll("button[data-file]")) {
    const [name, kind, make] = files[button.dataset.file];
    button.addEventListener("click", () => saveFile(name, kind, make()));
  }
  begin();
})();
