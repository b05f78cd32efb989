// SPDX-License-Identifier: Apache-2.0
// Verifies an exported audit log with Node's standard library alone: all it knows of the program
// that wrote the log are docs/spec/audit-record.md and docs/spec/checkpoint.md.
import { createHash, createPublicKey, verify } from "node:crypto";
import { createReadStream, readFileSync } from "node:fs";
import { parseArgs } from "node:util";
import { gone, note as noteMissing } from "./missing.mjs";
const need = (holds, message) => { if (!holds) throw new Error(message); };
const sha = (...parts) => createHash("sha256").update(Buffer.concat(parts.map((p) => Buffer.from(p)))).digest();
const digest = (tag, text) => sha(`authguard-r/${tag}/1\0`, text);
const url64 = (bytes) => bytes.toString("base64url");
const IDENTIFIER = /^[a-z0-9][a-z0-9_.:-]{0,63}$/;
const LINK = ["action", "decision", "evidence", "mid", "prev", "seq", "state", "time_ms"];
// RFC 8785, for what records hold: no fractions, and no number that a double cannot hold
function canonical(value) {
  if (Array.isArray(value)) return `[${value.map(canonical).join(",")}]`;
  const member = (name) => `${canonical(name)}:${canonical(value[name])}`;
  if (value !== null && typeof value === "object") return `{${Object.keys(value).sort().map(member).join(",")}}`;
  if (typeof value === "number") need(Number.isSafeInteger(value), "a number that is no integer");
  if (typeof value === "string") need(!/\p{Surrogate}/u.test(value), "a text that is no Unicode");
  return JSON.stringify(value);
}
function parsed(text, what) {
  const value = JSON.parse(text);
  need(canonical(value) === text, `${what} is not canonical`);
  return value;
}
const fields = (value, names, what) => {
  need(value !== null && typeof value === "object" && !Array.isArray(value), `${what} is no object`);
  need(Object.keys(value).sort().join() === names.join(), `${what} has other fields`);
};

// one row: canonical bytes, place in the chain, evidence, link, commitments
function checkRow(row, seq, prev, signed) {
  fields(row, ["link", "record", "sealed", "seq"], "the line");
  const record = parsed(row.record, "the record");
  fields(record, ["committed", "kind", "link", "open"], "the record");
  fields(record.link, LINK, "the link");
  const { link, committed, kind, open } = record;
  need(row.seq === seq && link.seq === seq, `expected record ${seq}: missing, inserted or reordered`);
  need(IDENTIFIER.test(kind) && IDENTIFIER.test(link.decision), "a kind or decision that is no identifier");
  need(["mid", "action", "state"].every((name) => typeof link[name] === "string"), "a name that is no text");
  need(Number.isSafeInteger(link.time_ms) && link.time_ms >= 0, "a time that is none");
  need(link.prev === url64(prev), "does not follow the record before it");
  need(link.evidence === url64(digest("evidence", canonical({ committed, kind, open, v: 1 }))), "its fields do not match their digest");
  const own = digest("audit", canonical(link));
  need(row.link === url64(own), "its link does not match its fields");
  need(Object.values(committed).every((text) => /^[\w-]{43}$/.test(text)), "a commitment that is none");
  const sealed = parsed(row.sealed, "the values");
  for (const [name, item] of Object.entries(sealed)) {
    fields(item, ["salt", "value"], `the value ${name}`);
    const expected = url64(digest("commitment", canonical({ name, salt: item.salt, value: item.value })));
    need(Object.hasOwn(committed, name) && committed[name] === expected, `the value ${name} does not match its commitment`);
  }
  noteMissing(record, sealed, signed);
  return own;
}

// RFC 6962: the roots of the complete subtrees, the largest first
function grow(peaks, size, leaf) {
  peaks.push(sha([0], leaf));
  for (let left = size; left % 2 === 1; left = (left - 1) / 2) peaks.push(sha([1], ...peaks.splice(-2)));
}
const rootOf = (peaks) => (peaks.length ? peaks.reduceRight((right, left) => sha([1], left, right)) : sha(""));
function readKey(text) {
  const [, name, id, encoded] = /^([^\s+]+)\+([0-9a-f]{8})\+([A-Za-z0-9+/=]+)$/.exec(text.trim()) ?? [];
  const raw = Buffer.from(encoded ?? "", "base64");
  need(raw.length === 33 && (raw[0] === 1 || raw[0] === 4), `no Ed25519 verifier key: ${text}`);
  need(sha(`${name}\n`, raw).subarray(0, 4).toString("hex") === id, `the id of ${name} is another key's`);
  const x = url64(raw.subarray(1));
  return { name, id, type: raw[0], raw: x, key: createPublicKey({ key: { kty: "OKP", crv: "Ed25519", x }, format: "jwk" }) };
}

// a signed note: which of the keys signed it; a known key's signature that does not hold refuses all
function signers(note, keys) {
  const [at, found] = [note.lastIndexOf("\n\n"), new Set()];
  need(at > 0 && note.endsWith("\n"), "the checkpoint is no signed note");
  const text = note.slice(0, at + 1);
  for (const line of note.slice(at + 2, -1).split("\n")) {
    const [, name, encoded] = /^\u2014 ([^\s+]+) ([A-Za-z0-9+/]+=*)$/.exec(line) ?? [];
    const raw = Buffer.from(encoded ?? "", "base64");
    need(name && raw.toString("base64") === encoded, "the checkpoint has a line that is no signature");
    const key = keys.find((one) => one.name === name && one.id === raw.subarray(0, 4).toString("hex"));
    if (!key) continue;
    const time = key.type === 4 && raw.length === 76 ? raw.readBigUInt64BE(4) : 0n;
    const message = key.type === 4 ? `cosignature/v1\ntime ${time}\n${text}` : text;
    const signature = raw.subarray(key.type === 4 ? 12 : 4);
    need(signature.length === 64 && verify(null, Buffer.from(message), key.key, signature), `the signature of ${name} does not hold`);
    found.add(key);
  }
  return { text, found };
}
function readCheckpoint(note, keys, witnesses, quorum) {
  const { text, found } = signers(note, [...keys, ...witnesses]);
  const [origin, size, root, ...more] = text.slice(0, -1).split("\n");
  const chains = more.filter((line) => line.startsWith("chain "));
  need(origin && root && more.every(Boolean) && chains.length <= 1 && /^(0|[1-9]\d{0,15})$/.test(size), "the note is no checkpoint");
  const own = keys.filter((key) => key.name === origin && key.type === 1);
  need(own.length > 0 && own.every((key) => found.has(key)), `the checkpoint of ${origin} is not signed by the key`);
  const cosigned = new Set(witnesses.filter((key) => key.type === 4 && found.has(key)).map((key) => key.raw)).size;
  need(cosigned >= quorum, `${cosigned} of ${quorum} witnesses have cosigned`);
  return { size: Number(size), root, chain: chains[0]?.slice(6), by: quorum > 0 ? "witnessed" : "checkpoint" };
}

async function* linesOf(path) {
  const decoder = new TextDecoder("utf-8", { fatal: true, ignoreBOM: true });
  let rest = Buffer.alloc(0);
  for await (const chunk of createReadStream(path)) {
    rest = Buffer.concat([rest, chunk]);
    for (let end; (end = rest.indexOf(10)) >= 0; rest = rest.subarray(end + 1)) yield decoder.decode(rest.subarray(0, end));
  }
  if (rest.length) yield decoder.decode(rest);
}

async function main() {
  const many = { type: "string", multiple: true, default: [] };
  const options = { key: many, witness: many, quorum: { type: "string" }, checkpoint: { type: "string" } };
  const { values, positionals: [path] } = parseArgs({ options, allowPositionals: true });
  const [keys, witnesses] = [values.key.map(readKey), values.witness.map(readKey)];
  let last = "", lines = 0, note = values.checkpoint && readFileSync(values.checkpoint, "utf8");
  for await (const line of linesOf(path)) [last, lines] = [line, lines + 1];
  need(lines > 0, "the file is empty");
  const rows = last.startsWith('{"checkpoint":') ? lines - 1 : lines;
  if (rows < lines) note ??= parsed(last, "the last line").checkpoint;
  need(note || !keys.length, "there is no checkpoint that the key could have signed");
  const known = keys.length ? readCheckpoint(note, keys, witnesses, Number(values.quorum ?? witnesses.length)) : null;
  let [prev, peaks] = [Buffer.alloc(32), []];
  const same = () => known.root === rootOf(peaks).toString("base64") && [undefined, prev.toString("base64")].includes(known.chain);
  const fits = () => need(known?.size !== size || same(), "not the records that were signed");
  fits(size = 0);
  for await (const line of linesOf(path)) {
    if (size === rows) break;
    prev = checkRow(parsed(line, "the line"), size, prev, known?.size ?? Infinity);
    fits(grow(peaks, size++, prev));
  }
  need(!known || known.size <= size, `expected the ${known?.size} signed records: the log is cut off`);
  console.log(`whole: ${size} records, head ${url64(prev)}, root ${rootOf(peaks).toString("base64")}`);
  for (const [key, at] of gone) console.log(`MISSING: ${key}, last at record ${at}: no order says why`);
  process.exitCode = gone.size ? 1 : 0;
  console.log(known ? `anchored: ${known.by}, ${known.size} of ${size} records` : "anchored: unanchored");
}
let size = null; // records that were found whole; null before the first was looked at
main().catch((error) => {
  const unread = error.code && error.code !== "ERR_ENCODING_INVALID_ENCODED_DATA"; // the file's or an option's fault
  const told = unread || size === null ? "NOT VERIFIED" : `NOT WHOLE at record ${size}`;
  (unread ? console.error : console.log)(`${told}: ${error.message.split("\n")[0]}`);
  process.exitCode = told === "NOT VERIFIED" ? 4 : 1;
});
