// The files that a page can give back, made from what it shows.
"use strict";

// Places of the records of a range, three numbers each [m].
const placesOf = (meta, bytes, [first, count]) => {
  const data = new DataView(bytes.buffer, bytes.byteOffset), places = new Float32Array(3 * count);
  for (let k = 0; k < count; k++) {
    for (let i = 0; i < 3; i++) {
      const unit = data.getUint16(RECORD * (first + k) + 2 * i, true);
      places[3 * k + i] = meta.low[i] + (meta.extent * unit) / 65535;
    }
  }
  return places;
};

// The points of all views, three numbers each, and the colours of their views.
const colouredPoints = (meta, bytes) => {
  const total = meta.ranges.views.reduce((sum, range) => sum + range[1], 0);
  const places = new Float32Array(3 * total), colours = new Uint8Array(3 * total);
  let at = 0;
  meta.ranges.views.forEach((range, view) => {
    places.set(placesOf(meta, bytes, range), at);
    const colour = [1, 3, 5].map((i) => parseInt(meta.colours[view].slice(i, i + 2), 16));
    for (const end = at + 3 * range[1]; at < end; at += 3) colours.set(colour, at);
  });
  return { places, colours };
};

// The points of all views as a PLY file.
const makePly = (meta, bytes) => {
  const { places, colours } = colouredPoints(meta, bytes), total = places.length / 3;
  const header = new TextEncoder().encode(
    `ply\nformat binary_little_endian 1.0\nelement vertex ${total}\n` +
    ["x", "y", "z"].map((name) => `property float ${name}\n`).join("") +
    ["red", "green", "blue"].map((name) => `property uchar ${name}\n`).join("") + "end_header\n");
  const body = new DataView(new ArrayBuffer(15 * total));
  for (let k = 0; k < total; k++) {
    for (let i = 0; i < 3; i++) {
      body.setFloat32(15 * k + 4 * i, places[3 * k + i], true);
      body.setUint8(15 * k + 12 + i, colours[3 * k + i]);
    }
  }
  return [header, body.buffer];
};

// The surface as a binary glTF 2.0 file, which has y up: (x, y, z) becomes (x, z, -y).
const makeGlb = (meta, bytes, faces) => {
  const places = placesOf(meta, bytes, meta.ranges.mesh);
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  for (let k = 0; k < places.length; k += 3) {
    [places[k + 1], places[k + 2]] = [places[k + 2], -places[k + 1]];
    for (let i = 0; i < 3; i++) {
      low[i] = Math.min(low[i], places[k + i]);
      high[i] = Math.max(high[i], places[k + i]);
    }
  }
  const size = places.byteLength + faces.byteLength;
  const description = JSON.stringify({
    asset: { version: "2.0", generator: "scan3d_twin" }, scene: 0, scenes: [{ nodes: [0] }],
    nodes: [{ mesh: 0 }], meshes: [{ primitives: [{ attributes: { POSITION: 0 }, indices: 1 }] }],
    buffers: [{ byteLength: size }],
    bufferViews: [
      { buffer: 0, byteOffset: 0, byteLength: places.byteLength, target: 34962 },
      { buffer: 0, byteOffset: places.byteLength, byteLength: faces.byteLength, target: 34963 },
    ],
    accessors: [
      { bufferView: 0, componentType: 5126, count: places.length / 3, type: "VEC3", min: low, max: high },
      { bufferView: 1, componentType: 5125, count: faces.length, type: "SCALAR" },
    ],
  });
  const json = new TextEncoder().encode(description.padEnd(4 * Math.ceil(description.length / 4)));
  const words = (...numbers) => new Uint32Array(numbers);
  return [
    words(0x46546c67, 2, 28 + json.length + size), words(json.length, 0x4e4f534a), json,
    words(size, 0x004e4942), places, faces,
  ];
};

const saveFile = (name, kind, parts) => {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob(parts, { type: kind }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
};
