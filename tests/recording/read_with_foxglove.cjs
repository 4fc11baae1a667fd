// Prints what Foxglove's own libraries read from an MCAP file: topic, type, count, last message.
const { open } = require("node:fs/promises");
const { McapIndexedReader } = require("@mcap/core");
const { FileHandleReadable } = require("@mcap/nodejs");
const { loadDecompressHandlers } = require("@mcap/support");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader } = require("@foxglove/rosmsg2-serialization");

// Long arrays of numbers as base64 of their bytes, 64-bit integers as numbers
function plain(key, value) {
  if (ArrayBuffer.isView(value)) {
    return Buffer.from(value.buffer, value.byteOffset, value.byteLength).toString("base64");
  }
  return typeof value === "bigint" ? Number(value) : value;
}

async function main(path) {
  const readable = new FileHandleReadable(await open(path, "r"));
  const decompressHandlers = await loadDecompressHandlers();
  const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
  const decoders = new Map();
  const topics = {};
  for await (const message of reader.readMessages()) {
    const channel = reader.channelsById.get(message.channelId);
    const schema = reader.schemasById.get(channel.schemaId);
    if (!decoders.has(channel.id)) {
      const text = new TextDecoder().decode(schema.data);
      decoders.set(channel.id, new MessageReader(parse(text, { ros2: true })));
    }
    const topic = (topics[channel.topic] ??= { type: schema.name, count: 0 });
    topic.count += 1;
    topic.last = decoders.get(channel.id).readMessage(message.data);
  }
  console.log(JSON.stringify(topics, plain));
}

main(process.argv[2]);
