// Bags by @mcap/core and @foxglove/rosbag: `bags.mjs read PATH` or `bags.mjs write PATH OUT`; prints JSON.
import { readFile, writeFile } from "node:fs/promises";
import { McapIndexedReader, McapWriter, TempBuffer } from "@mcap/core";
import { loadDecompressHandlers } from "@mcap/support";
import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import rosbag from "@foxglove/rosbag";
import node from "@foxglove/rosbag/node.js";
import bz2 from "@foxglove/wasm-bz2";
import lz4 from "@foxglove/wasm-lz4";
import { load } from "js-yaml";

const [job, path, out] = process.argv.slice(2);

function plain(value) {
  if (typeof value === "bigint") return Number(value);
  if (Number.isNaN(value)) return "nan";
  if (typeof value === "number") return Number.isFinite(value) ? value : value > 0 ? "inf" : "-inf";
  if (ArrayBuffer.isView(value)) return Array.from(value, plain);
  if (Array.isArray(value)) return value.map(plain);
  if (typeof value !== "object") return value;
  const names = Object.keys(value);
  if (names.join() === "sec,nsec") return { sec: value.sec, nanosec: value.nsec };
  return Object.fromEntries(names.filter((name) => name !== "seq").map((name) => [name, plain(value[name])]));
}

async function openMcap() {
  const readable = new TempBuffer(await readFile(path));
  return McapIndexedReader.Initialize({ readable, decompressHandlers: await loadDecompressHandlers() });
}

async function readMcap(messages, latched) {
  const reader = await openMcap(), decoders = new Map();
  for (const { id, topic, schemaId, metadata } of reader.channelsById.values()) {
    const text = new TextDecoder().decode(reader.schemasById.get(schemaId).data);
    decoders.set(id, [topic, new MessageReader(parse(text, { ros2: true }))]);
    const profiles = load(metadata.get("offered_qos_profiles") || "[]");
    if (profiles.some(({ durability }) => [1, "transient_local"].includes(durability))) latched.push(topic);
  }
  for await (const { channelId, logTime, data } of reader.readMessages()) {
    const [topic, decoder] = decoders.get(channelId);
    (messages[topic] ??= []).push([Number(logTime), plain(decoder.readMessage(data))]);
  }
}

async function readRosbag(messages) {
  await lz4.isLoaded;
  const unpacker = await bz2.init();
  const decompress = { bz2: (data, size) => unpacker.decompress(data, size, { small: false }), lz4 };
  const bag = new rosbag.Bag(new node.FileReader(path), { decompress });
  await bag.open();
  for await (const { topic, message, timestamp } of bag.messageIterator())
    (messages[topic] ??= []).push([timestamp.sec * 1e9 + timestamp.nsec, plain(message)]);
}

async function copyMcap() {
  const reader = await openMcap(), writable = new TempBuffer(), schemas = new Map(), channels = new Map();
  const writer = new McapWriter({ writable, chunkSize: 4096 });
  await writer.start({ profile: "ros2", library: "" });
  for (const schema of reader.schemasById.values()) schemas.set(schema.id, await writer.registerSchema(schema));
  for (const channel of reader.channelsById.values())
    channels.set(channel.id, await writer.registerChannel({ ...channel, schemaId: schemas.get(channel.schemaId) }));
  for await (const message of reader.readMessages())
    await writer.addMessage({ ...message, channelId: channels.get(message.channelId) });
  await writer.end();
  await writeFile(out, writable.get());
}

if (job === "write") {
  await copyMcap();
  console.log(JSON.stringify({ "@mcap/core": out }));
} else {
  const messages = {}, latched = [];
  await (path.endsWith(".bag") ? readRosbag(messages) : readMcap(messages, latched));
  console.log(JSON.stringify({ messages, latched: latched.sort() }));
}
