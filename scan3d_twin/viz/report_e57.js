// The points of a page as an ASTM E57 file (E2807-11): pages with checksums, in which lie a header,
// a compressed vector of the points, and the XML that describes them.
"use strict";

// A name and no address: the page asks nobody.
const E57_NAMESPACE = "http" + "://www.astm.org/COMMIT/E57/2010-e57-v1.0";
const E57_PAGE = 1024, E57_PAYLOAD = 1020;
const E57_PACKET = 4000; // points of a data packet, which holds 64 kB at most

const CRC32C = Uint32Array.from({ length: 256 }, (_, byte) => {
  for (let bit = 0; bit < 8; bit++) byte = byte & 1 ? (byte >>> 1) ^ 0x82f63b78 : byte >>> 1;
  return byte >>> 0;
});
const crc32c = (bytes, start = 0) => {
  let crc = ~start;
  for (const byte of bytes) crc = CRC32C[(crc ^ byte) & 255] ^ (crc >>> 8);
  return ~crc >>> 0;
};

// Where a byte is in the file, pages and their checksums counted.
const inPages = (at) => E57_PAGE * Math.floor(at / E57_PAYLOAD) + (at % E57_PAYLOAD);

// Points one after another in packets: x, y, z as single floats, then red, green, blue.
const packE57 = ({ places, colours }) => {
  const n = places.length / 3, packets = [];
  for (let first = 0; first < n; first += E57_PACKET) {
    const count = Math.min(E57_PACKET, n - first), size = 4 * Math.ceil((18 + 15 * count) / 4);
    const packet = new DataView(new ArrayBuffer(size));
    packet.setUint8(0, 1);
    packet.setUint16(2, size - 1, true);
    packet.setUint16(4, 6, true);
    for (let i = 0; i < 3; i++) {
      packet.setUint16(6 + 2 * i, 4 * count, true);
      packet.setUint16(12 + 2 * i, count, true);
      for (let k = 0; k < count; k++) {
        packet.setFloat32(18 + 4 * (i * count + k), places[3 * (first + k) + i], true);
        packet.setUint8(18 + (12 + i) * count + k, colours[3 * (first + k) + i]);
      }
    }
    packets.push(new Uint8Array(packet.buffer));
  }
  return packets;
};

// The section of a compressed vector that begins at the byte 48 of the content.
const makeE57Section = (packets) => {
  const size = packets.reduce((sum, packet) => sum + packet.length, 32);
  const head = new DataView(new ArrayBuffer(32)), index = new DataView(new ArrayBuffer(32));
  const long = (view, at, value) => view.setBigUint64(at, BigInt(value), true);
  head.setUint8(0, 1);
  long(head, 8, size + index.byteLength);
  long(head, 16, inPages(48 + 32));
  long(head, 24, inPages(48 + size));
  index.setUint16(2, index.byteLength - 1, true);
  index.setUint16(4, 1, true);
  long(index, 24, inPages(48 + 32));
  return [head, ...packets, index].map((part) => new Uint8Array(part.buffer));
};

// A number that says which content this is, the same for the same content.
const makeE57Guid = (packets) => {
  const digits = [1, 2, 3, 4].map((start) => packets.reduce((crc, each) => crc32c(each, crc), start)
    .toString(16).padStart(8, "0")).join("");
  return `{${digits.slice(0, 8)}-${digits.slice(8, 12)}-8${digits.slice(13, 16)}-` +
    `8${digits.slice(17, 20)}-${digits.slice(20)}}`;
};

const describeE57 = ({ places }, guid) => {
  const text = (name, value) => `<${name} type="String"><![CDATA[${value}]]></${name}>`;
  const number = (name, type, value) => `<${name} type="${type}">${value}</${name}>`;
  const box = ["x", "y", "z"].map((axis, i) => {
    let low = Infinity, high = -Infinity;
    for (let k = i; k < places.length; k += 3) {
      low = Math.min(low, places[k]);
      high = Math.max(high, places[k]);
    }
    return number(`${axis}Minimum`, "Float", low) + number(`${axis}Maximum`, "Float", high);
  });
  const channels = ["Red", "Green", "Blue"].map((name) => `color${name}`);
  return `<?xml version="1.0" encoding="UTF-8"?>
<e57Root type="Structure" xmlns="${E57_NAMESPACE}">
${text("formatName", "ASTM E57 3D Imaging Data File")}${text("guid", guid)}
${number("versionMajor", "Integer", 1)}${number("versionMinor", "Integer", 0)}
${text("e57LibraryVersion", "scan3d_twin")}${text("coordinateMetadata", "")}
<data3D type="Vector" allowHeterogeneousChildren="1"><vectorChild type="Structure">
${text("guid", guid)}${text("name", "model")}
<cartesianBounds type="Structure">${box.join("")}</cartesianBounds>
<colorLimits type="Structure">${channels.map((name) =>
    number(`${name}Minimum`, "Integer", 0) + number(`${name}Maximum`, "Integer", 255)).join("")}</colorLimits>
<points type="CompressedVector" fileOffset="48" recordCount="${places.length / 3}">
<prototype type="Structure">${["X", "Y", "Z"].map((axis) =>
    `<cartesian${axis} type="Float" precision="single"/>`).join("")}${channels.map((name) =>
    `<${name} type="Integer" minimum="0" maximum="255"/>`).join("")}</prototype>
<codecs type="Vector" allowHeterogeneousChildren="1"></codecs></points>
</vectorChild></data3D>
<images2D type="Vector" allowHeterogeneousChildren="1"></images2D>
</e57Root>
`;
};

const makeE57 = (meta, bytes) => {
  // Make the content
  const points = colouredPoints(meta, bytes), packets = packE57(points);
  const section = makeE57Section(packets);
  const xml = new TextEncoder().encode(describeE57(points, makeE57Guid(packets)));
  const begin = section.reduce((sum, part) => sum + part.length, 48);
  const pages = Math.ceil((begin + xml.length) / E57_PAYLOAD);
  const header = new DataView(new ArrayBuffer(48));
  new Uint8Array(header.buffer).set(new TextEncoder().encode("ASTM-E57"));
  header.setUint32(8, 1, true);
  [E57_PAGE * pages, inPages(begin), xml.length, E57_PAGE].forEach((value, i) =>
    header.setBigUint64(16 + 8 * i, BigInt(value), true));
  const content = new Uint8Array(E57_PAYLOAD * pages);
  let at = 0;
  for (const part of [new Uint8Array(header.buffer), ...section, xml]) {
    content.set(part, at);
    at += part.length;
  }

  // Cut it into pages, each with its checksum, high byte first
  const file = new Uint8Array(E57_PAGE * pages), view = new DataView(file.buffer);
  for (let page = 0; page < pages; page++) {
    const payload = content.subarray(E57_PAYLOAD * page, E57_PAYLOAD * (page + 1));
    file.set(payload, E57_PAGE * page);
    view.setUint32(E57_PAGE * page + E57_PAYLOAD, crc32c(payload), false);
  }
  return [file];
};
