// Reads an MCAP file of JSON messages with the format's own reader; prints what is on each channel.

import {open} from "node:fs/promises";
import {McapIndexedReader} from "@mcap/core";
import {loadDecompressHandlers} from "@mcap/support";
import Ajv from "ajv/dist/2020.js";

const file = await open(process.argv[2]);
const readable = {
  size: async () => BigInt((await file.stat()).size),
  read: async (offset, size) => (await file.read(new Uint8Array(Number(size)), 0, Number(size), Number(offset))).buffer,
};
const reader = await McapIndexedReader.Initialize({readable, decompressHandlers: await loadDecompressHandlers()});
const text = new TextDecoder(), ajv = new Ajv({strict: true}), validators = new Map();
for (const [id, schema] of reader.schemasById) validators.set(id, ajv.compile(JSON.parse(text.decode(schema.data))));

const topics = {};
for (const channel of reader.channelsById.values()) topics[channel.topic] = {messages: 0, last: null, errors: []};
for await (const {channelId, data} of reader.readMessages()) {
  const {topic, schemaId} = reader.channelsById.get(channelId), found = topics[topic], validate = validators.get(schemaId);
  found.last = JSON.parse(text.decode(data));
  found.messages += 1;
  if (!validate(found.last)) found.errors.push(ajv.errorsText(validate.errors));
}
console.log(JSON.stringify(topics));
