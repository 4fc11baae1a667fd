// Draws the model with WebGL 1, without a library: points by view, the surface, lines.
"use strict";

// Where the eye is, and how places of the world come onto the canvas.
const makeCamera = (start, canvas) => {
  const state = {};
  const reset = () => Object.assign(state, start, { middle: [...start.middle] });
  reset();
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const axes = () => {
    const { azimuth: a, elevation: e } = state;
    const back = [Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e)];
    const right = [-Math.sin(a), Math.cos(a), 0];
    const up = [-Math.sin(e) * Math.cos(a), -Math.sin(e) * Math.sin(a), Math.cos(e)];
    return { back, right, up };
  };
  // Narrow screens stand back, so that what fits in the still picture fits here.
  const reach = () => state.distance * Math.max(1, start.aspect / (canvas.width / canvas.height));
  const metresPerPixel = () => (2 * Math.tan(start.fov / 2) * reach()) / canvas.clientHeight;
  const matrix = () => {
    const { back, right, up } = axes();
    const d = reach(), eye = state.middle.map((m, i) => m + d * back[i]);
    const f = 1 / Math.tan(start.fov / 2), aspect = canvas.width / canvas.height;
    const near = 0.02, far = 60, z = (far + near) / (near - far), w = (2 * far * near) / (near - far);
    const row = (axis, scale) => [...axis.map((v) => v * scale), -dot(axis, eye) * scale];
    const x = row(right, f / aspect), y = row(up, f), v = row(back, 1);
    const numbers = [];
    for (let column = 0; column < 4; column++) {
      numbers.push(x[column], y[column], z * v[column] + (column === 3 ? w : 0), -v[column]);
    }
    return new Float32Array(numbers);
  };
  // Column, row [CSS pixels] and depth [m] of a place.
  const project = (place, m = matrix()) => {
    const c = [0, 1, 2, 3].map((i) => m[i] * place[0] + m[4 + i] * place[1] + m[8 + i] * place[2] + m[12 + i]);
    return [(canvas.clientWidth * (1 + c[0] / c[3])) / 2, (canvas.clientHeight * (1 - c[1] / c[3])) / 2, c[3]];
  };
  return {
    reset, matrix, project, metresPerPixel, fov: start.fov,
    turn(dx, dy) {
      state.azimuth -= 0.006 * dx;
      state.elevation = Math.min(1.55, Math.max(-0.6, state.elevation + 0.006 * dy));
    },
    slide(dx, dy) {
      const { right, up } = axes(), scale = metresPerPixel();
      state.middle = state.middle.map((m, i) => m - scale * dx * right[i] + scale * dy * up[i]);
    },
    zoom(factor) { state.distance = Math.min(30, Math.max(0.2, state.distance * factor)); },
  };
};

const VERTEX = `
  attribute vec3 place; attribute float shade, value;
  uniform mat4 camera; uniform vec3 low, colour, section; uniform float extent, size, ramp, cut;
  uniform vec2 heights; varying vec3 tint;
  void main() {
    vec3 p = low + extent * place, c = colour;
    gl_Position = dot(section, p) <= cut ? camera * vec4(p, 1.0) : vec4(2.0, 2.0, 2.0, 1.0);
    float h = ramp > 1.5 ? clamp((p.z - heights.x) / max(1e-3, heights.y - heights.x), 0.0, 1.0) : value;
    if (ramp > 0.5) {
      c = mix(mix(vec3(.19, .32, .75), vec3(.12, .66, .55), min(1.0, 2.0 * h)),
              vec3(.98, .78, .22), max(0.0, 2.0 * h - 1.0));
    }
    tint = c * (0.55 + 0.6 * shade);
    gl_PointSize = clamp(size / gl_Position.w, 1.5, 24.0);
  }`;
const ROUND = `
  precision mediump float; varying vec3 tint;
  void main() {
    vec2 d = gl_PointCoord - 0.5;
    if (dot(d, d) > 0.25) discard;
    gl_FragColor = vec4(tint, 1.0);
  }`;
const PLAIN = `
  precision mediump float; varying vec3 tint;
  void main() { gl_FragColor = vec4(tint, 1.0); }`;
const LINES = `
  attribute vec3 place; attribute vec4 colour; uniform mat4 camera; uniform float upto;
  varying vec3 tint;
  void main() {
    gl_Position = colour.w <= upto ? camera * vec4(place, 1.0) : vec4(2.0, 2.0, 2.0, 1.0);
    tint = colour.rgb;
  }`;
const RECORD = 12;  // bytes of a point: three coordinates of 16 bits, brightness, five figures

// Returns what paints the model on the canvas, or null where there is no WebGL.
const makeDrawing = (canvas, meta, bytes, faces) => {
  const gl = canvas.getContext("webgl", { antialias: true, preserveDrawingBuffer: true });
  if (!gl) return null;
  const build = (kind, source) => {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    return shader;
  };
  const link = (vertex, fragment) => {
    const program = gl.createProgram();
    gl.attachShader(program, build(gl.VERTEX_SHADER, vertex));
    gl.attachShader(program, build(gl.FRAGMENT_SHADER, fragment));
    gl.linkProgram(program);
    return program;
  };
  const buffer = (kind, data) => {
    const made = gl.createBuffer();
    gl.bindBuffer(kind, made);
    gl.bufferData(kind, data, gl.STATIC_DRAW);
    return made;
  };
  gl.getExtension("OES_element_index_uint");
  const points = link(VERTEX, ROUND), surface = link(VERTEX, PLAIN), lines = link(LINES, PLAIN);
  const cloud = buffer(gl.ARRAY_BUFFER, bytes);
  const corners = buffer(gl.ELEMENT_ARRAY_BUFFER, faces);
  const edges = buffer(gl.ARRAY_BUFFER, new Float32Array(meta.lines));
  const drawn = gl.createBuffer();
  const rgb = (name) => [1, 3, 5].map((i) => parseInt(name.slice(i, i + 2), 16) / 255);

  // Set what points and surface share: records from `first` on, camera, section and colours.
  const begin = (program, wanted, camera, first, sized) => {
    const at = (name) => gl.getUniformLocation(program, name);
    gl.useProgram(program);
    gl.bindBuffer(gl.ARRAY_BUFFER, cloud);
    const figure = Math.max(0, wanted.value);
    for (const [name, count, kind, offset] of [
      ["place", 3, gl.UNSIGNED_SHORT, 0], ["shade", 1, gl.UNSIGNED_BYTE, 6],
      ["value", 1, gl.UNSIGNED_BYTE, 7 + figure],
    ]) {
      const where = gl.getAttribLocation(program, name);
      gl.enableVertexAttribArray(where);
      gl.vertexAttribPointer(where, count, kind, true, RECORD, RECORD * first + offset);
    }
    gl.uniformMatrix4fv(at("camera"), false, camera);
    gl.uniform3fv(at("low"), meta.low);
    gl.uniform1f(at("extent"), meta.extent);
    gl.uniform2fv(at("heights"), meta.heights);
    gl.uniform3fv(at("section"), wanted.section.normal);
    gl.uniform1f(at("cut"), wanted.section.cut);
    return (colour, size, ramp) => {
      gl.uniform3fv(at("colour"), rgb(colour));
      gl.uniform1f(at("size"), size * sized);
      gl.uniform1f(at("ramp"), ramp);
    };
  };

  const drawLines = (camera, numbers, upto) => {
    gl.useProgram(lines);
    const place = gl.getAttribLocation(lines, "place"), colour = gl.getAttribLocation(lines, "colour");
    for (const where of [place, colour]) gl.enableVertexAttribArray(where);
    gl.vertexAttribPointer(place, 3, gl.FLOAT, false, 28, 0);
    gl.vertexAttribPointer(colour, 4, gl.FLOAT, false, 28, 12);
    gl.uniformMatrix4fv(gl.getUniformLocation(lines, "camera"), false, camera);
    gl.uniform1f(gl.getUniformLocation(lines, "upto"), upto);
    gl.drawArrays(gl.LINES, 0, numbers / 7);
  };

  return (wanted, camera) => {
    const ratio = Math.min(2, window.devicePixelRatio || 1);
    const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
    if (!width || !height || gl.isContextLost()) return;
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.enable(gl.DEPTH_TEST);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const matrix = camera.matrix(), ramp = wanted.value >= 0 ? 1 : wanted.byHeight ? 2 : 0;
    const dot1cm = (0.0115 * height) / (2 * Math.tan(camera.fov / 2));
    const { views, around, missing, mesh } = meta.ranges;

    let style = begin(points, wanted, matrix, 0, dot1cm);
    const show = (range) => gl.drawArrays(gl.POINTS, ...range);
    if (wanted.points) {
      views.forEach((range, k) => {
        if (!wanted.views[k] || k > wanted.upto) return;
        style(meta.colours[k], 1, ramp);
        show(range);
      });
    }
    if (wanted.around) { style(meta.grey, 0.8, 0); show(around); }
    if (wanted.missing) { style(meta.missing, 0.8, 0); show(missing); }
    if (wanted.mesh) {
      style = begin(surface, wanted, matrix, mesh[0], 0);
      style(meta.surface, 0, ramp === 2 ? 2 : 0);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, corners);
      gl.drawElements(gl.TRIANGLES, faces.length, gl.UNSIGNED_INT, 0);
    }
    gl.bindBuffer(gl.ARRAY_BUFFER, edges);
    drawLines(matrix, meta.lines.length, wanted.upto);
    if (wanted.measured.length === 2) {
      const ends = wanted.measured.flatMap((place) => [...place, 0.9, 0.1, 0.5, 0]);
      gl.disable(gl.DEPTH_TEST);
      gl.bindBuffer(gl.ARRAY_BUFFER, drawn);
      gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(ends), gl.DYNAMIC_DRAW);
      drawLines(matrix, ends.length, 0);
    }
  };
};
