// The interactive model: points by view with WebGL 1, without a library. Where there is no WebGL
// the page keeps its still picture.
"use strict";
(() => {
  const meta = JSON.parse(document.getElementById("meta").textContent);
  const box = document.getElementById("model");
  const canvas = box.querySelector("canvas");
  const gl = canvas.getContext("webgl", { antialias: true, preserveDrawingBuffer: true });
  if (!gl) return;

  const text = document.getElementById("cloud").textContent.trim();
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));

  const build = (kind, source) => {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw gl.getShaderInfoLog(shader);
    return shader;
  };
  const link = (vertex, fragment) => {
    const program = gl.createProgram();
    gl.attachShader(program, build(gl.VERTEX_SHADER, vertex));
    gl.attachShader(program, build(gl.FRAGMENT_SHADER, fragment));
    gl.linkProgram(program);
    return program;
  };

  const N = meta.colours.length;
  const points = link(`
    attribute vec3 place; attribute float shade;
    uniform mat4 camera; uniform vec3 low, colour; uniform float extent, size, byHeight;
    uniform vec2 heights; varying vec3 tint;
    void main() {
      vec3 p = low + extent * place, c = colour;
      gl_Position = camera * vec4(p, 1.0);
      if (byHeight > 0.5) {
        float h = clamp((p.z - heights.x) / max(1e-3, heights.y - heights.x), 0.0, 1.0);
        c = mix(mix(vec3(.19, .32, .75), vec3(.12, .66, .55), min(1.0, 2.0 * h)),
                vec3(.98, .78, .22), max(0.0, 2.0 * h - 1.0));
      }
      tint = c * (0.55 + 0.6 * shade);
      gl_PointSize = clamp(size / gl_Position.w, 1.5, 24.0);
    }`, `
    precision mediump float; varying vec3 tint;
    void main() {
      vec2 d = gl_PointCoord - 0.5;
      if (dot(d, d) > 0.25) discard;
      gl_FragColor = vec4(tint, 1.0);
    }`);
  const lines = link(`
    attribute vec3 place; attribute vec4 colour; uniform mat4 camera; uniform float upto;
    varying vec3 tint;
    void main() {
      gl_Position = colour.w <= upto ? camera * vec4(place, 1.0) : vec4(2.0, 2.0, 2.0, 1.0);
      tint = colour.rgb;
    }`, `
    precision mediump float; varying vec3 tint;
    void main() { gl_FragColor = vec4(tint, 1.0); }`);

  const cloud = gl.createBuffer();
  gl.bindBuffer(gl.ARRAY_BUFFER, cloud);
  gl.bufferData(gl.ARRAY_BUFFER, bytes, gl.STATIC_DRAW);
  const edges = gl.createBuffer();
  gl.bindBuffer(gl.ARRAY_BUFFER, edges);
  gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(meta.lines), gl.STATIC_DRAW);
  const rgb = (name) => [1, 3, 5].map((i) => parseInt(name.slice(i, i + 2), 16) / 255);

  const start = meta.camera;
  let state;
  const reset = () => {
    state = { ...start, middle: [...start.middle] };
  };
  reset();
  let wanted = 0;
  const draw = () => { wanted ||= requestAnimationFrame(paint); };

  const axes = () => {
    const { azimuth: a, elevation: e } = state;
    const back = [Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e)];
    const right = [-Math.sin(a), Math.cos(a), 0];
    const up = [-Math.sin(e) * Math.cos(a), -Math.sin(e) * Math.sin(a), Math.cos(e)];
    return { back, right, up };
  };
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  // Narrow screens stand back, so that what fits in the still picture fits here.
  const reach = () => state.distance * Math.max(1, start.aspect / (canvas.width / canvas.height));
  const cameraMatrix = () => {
    const { back, right, up } = axes();
    const d = reach(), eye = state.middle.map((m, i) => m + d * back[i]);
    const f = 1 / Math.tan(start.fov / 2), aspect = canvas.width / canvas.height;
    const near = 0.02, far = 60, z = (far + near) / (near - far), w = (2 * far * near) / (near - far);
    const row = (axis, scale) => [...axis.map((v) => v * scale), -dot(axis, eye) * scale];
    const x = row(right, f / aspect), y = row(up, f), v = row(back, 1);
    const matrix = [];
    for (let column = 0; column < 4; column++) {
      matrix.push(x[column], y[column], z * v[column] + (column === 3 ? w : 0), -v[column]);
    }
    return new Float32Array(matrix);
  };

  const controls = document.getElementById("controls");
  const upto = document.getElementById("upto");
  const shown = document.getElementById("shown");
  const boxes = [...controls.querySelectorAll("input[data-view]")];
  const around = document.getElementById("around");
  const colouring = document.getElementById("colouring");

  function paint() {
    wanted = 0;
    const ratio = Math.min(2, window.devicePixelRatio || 1);
    const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
    if (!width || !height) return;
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.enable(gl.DEPTH_TEST);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const camera = cameraMatrix(), last = Number(upto.value);
    const at = (program, name) => gl.getUniformLocation(program, name);

    gl.useProgram(points);
    gl.bindBuffer(gl.ARRAY_BUFFER, cloud);
    const place = gl.getAttribLocation(points, "place"), shade = gl.getAttribLocation(points, "shade");
    gl.enableVertexAttribArray(place);
    gl.enableVertexAttribArray(shade);
    gl.vertexAttribPointer(place, 3, gl.UNSIGNED_SHORT, true, 8, 0);
    gl.vertexAttribPointer(shade, 1, gl.UNSIGNED_BYTE, true, 8, 6);
    gl.uniformMatrix4fv(at(points, "camera"), false, camera);
    gl.uniform3fv(at(points, "low"), meta.low);
    gl.uniform1f(at(points, "extent"), meta.extent);
    gl.uniform2fv(at(points, "heights"), meta.heights);
    const dot1cm = (0.0115 * height) / (2 * Math.tan(start.fov / 2));
    const show = (range, colour, size, byHeight) => {
      gl.uniform3fv(at(points, "colour"), rgb(colour));
      gl.uniform1f(at(points, "size"), size * dot1cm);
      gl.uniform1f(at(points, "byHeight"), byHeight ? 1 : 0);
      gl.drawArrays(gl.POINTS, range[0], range[1]);
    };
    boxes.forEach((each, k) => {
      if (each.checked && k <= last) show(meta.ranges[k], meta.colours[k], 1, colouring.value === "height");
    });
    if (around.checked) show(meta.ranges[N], meta.grey, 0.8, false);
    gl.disableVertexAttribArray(shade);

    gl.useProgram(lines);
    gl.bindBuffer(gl.ARRAY_BUFFER, edges);
    const corner = gl.getAttribLocation(lines, "place"), hue = gl.getAttribLocation(lines, "colour");
    gl.enableVertexAttribArray(corner);
    gl.enableVertexAttribArray(hue);
    gl.vertexAttribPointer(corner, 3, gl.FLOAT, false, 28, 0);
    gl.vertexAttribPointer(hue, 4, gl.FLOAT, false, 28, 12);
    gl.uniformMatrix4fv(at(lines, "camera"), false, camera);
    gl.uniform1f(at(lines, "upto"), last);
    gl.drawArrays(gl.LINES, 0, meta.lines.length / 7);
    gl.disableVertexAttribArray(hue);
    shown.textContent = last + 1 === N ? `all ${N}` : `${last + 1} of ${N}`;
  }

  const turn = (dx, dy) => {
    state.azimuth -= 0.006 * dx;
    state.elevation = Math.min(1.55, Math.max(-0.6, state.elevation + 0.006 * dy));
  };
  const slide = (dx, dy) => {
    const { right, up } = axes();
    const scale = (2 * Math.tan(start.fov / 2) * reach()) / canvas.clientHeight;
    state.middle = state.middle.map((m, i) => m - scale * dx * right[i] + scale * dy * up[i]);
  };
  const zoom = (factor) => {
    state.distance = Math.min(30, Math.max(0.2, state.distance * factor));
  };

  const fingers = new Map();
  const spread = () => {
    const [a, b] = [...fingers.values()];
    return Math.hypot(a.x - b.x, a.y - b.y);
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    canvas.focus({ preventScroll: true });
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const dx = event.clientX - before.x, dy = event.clientY - before.y;
    const wide = fingers.size > 1 ? spread() : 0;
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    if (fingers.size > 1) {
      zoom(wide / Math.max(1, spread()));
      slide(dx / 2, dy / 2);
    } else if (event.shiftKey || event.buttons === 2) slide(dx, dy);
    else turn(dx, dy);
    draw();
  });
  for (const name of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(name, (event) => fingers.delete(event.pointerId));
  }
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  // The wheel scrolls the page until the model was clicked.
  canvas.addEventListener("wheel", (event) => {
    if (document.activeElement !== canvas) return;
    event.preventDefault();
    zoom(Math.exp(0.001 * event.deltaY));
    draw();
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-20, 0], ArrowRight: [20, 0], ArrowUp: [0, -20], ArrowDown: [0, 20] }[event.key];
    if (step) turn(...step);
    else if (event.key === "+") zoom(0.9);
    else if (event.key === "-") zoom(1.1);
    else return;
    event.preventDefault();
    draw();
  });
  canvas.addEventListener("dblclick", () => { reset(); draw(); });
  document.getElementById("reset").addEventListener("click", () => { reset(); draw(); });
  controls.addEventListener("input", draw);
  new ResizeObserver(draw).observe(canvas);

  controls.classList.add("shown");
  box.classList.add("drawn");
  paint();
})();
