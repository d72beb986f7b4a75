// Protobuf decoder and encoder, driven by the schema that the server provides.

/** @typedef {[name: string, kind: string, repeated: boolean, presence: boolean]} Rule */
/** @typedef {{ messages: Record<string, Record<string, Rule>>, enums: Record<string, Record<string, string>> }} Schema */
/** @typedef {Record<string, any>} Message */
/** @typedef {(command: Message, onReply: (answer: Message) => void) => string | null} SendCommand Sends a command. Returns the reason if it cannot be sent. */

const VARINT = 0, FIXED64 = 1, BYTES = 2, FIXED32 = 5;
const TEXT = new TextDecoder();

export class Wire {
  /** @param {Schema} schema */
  constructor(schema) {
    this.schema = schema;
    /** Rules of each message, as a list and by field number. @type {Map<string, { all: Rule[], byNumber: Rule[] }>} */
    this.rules = new Map(Object.entries(schema.messages).map(([name, rules]) => {
      /** @type {Rule[]} */
      const byNumber = [];
      for (const [number, rule] of Object.entries(rules)) byNumber[Number(number)] = rule;
      return [name, { all: Object.values(rules), byNumber }];
    }));
  }

  /** Decodes a message. Absent fields have their default: 0, "", the first name of an enum, an empty list, or null. @param {string} name @param {Uint8Array} bytes @returns {Message} */
  decode(name, bytes) {
    const rules = this.rules.get(name);
    if (!rules) throw new Error(`no message ${name} in the schema`);
    /** @type {Message} */
    const message = {};
    for (const [field, kind, repeated, presence] of rules.all) {
      message[field] = repeated ? [] : presence ? null : this.defaultValue(kind);
    }
    const reader = new Reader(bytes);
    while (!reader.isAtEnd()) {
      const key = reader.varint();
      const rule = rules.byNumber[Math.floor(key / 8)];
      const type = key % 8;
      if (!rule) {
        reader.skip(type);
        continue;
      }
      const [field, kind, repeated] = rule;
      if (repeated && type === BYTES && isPacked(kind)) {
        const inner = new Reader(reader.bytes());
        while (!inner.isAtEnd()) message[field].push(this.value(kind, inner));
        continue;
      }
      const value = this.value(kind, reader);
      if (repeated) message[field].push(value);
      else message[field] = value;
    }
    return message;
  }

  /** Encodes a message. Fields that are undefined are omitted. @param {string} name @param {Message} message */
  encode(name, message) {
    /** @type {number[]} */
    const out = [];
    for (const [number, [field, kind, repeated]] of Object.entries(this.schema.messages[name])) {
      const names = this.schema.enums[kind];
      for (const value of repeated ? message[field] ?? [] : [message[field]]) {
        if (value === undefined) continue;
        if (kind === "string" || this.rules.has(kind)) {
          const bytes = kind === "string" ? new TextEncoder().encode(value) : this.encode(kind, value);
          varint(Number(number) * 8 + BYTES, out);
          varint(bytes.length, out);
          out.push(...bytes);
        } else if (kind === "double") {
          varint(Number(number) * 8 + FIXED64, out);
          out.push(...new Uint8Array(Float64Array.of(value).buffer));
        } else if (names || kind === "uint32" || kind === "uint64") {
          varint(Number(number) * 8 + VARINT, out);
          varint(names ? Number(Object.keys(names).find((key) => names[key] === value)) : value, out);
        } else throw new Error(`${name}.${field}: encoding of ${kind} is not implemented`);
      }
    }
    return new Uint8Array(out);
  }

  /** @param {string} kind */
  defaultValue(kind) {
    if (kind === "string") return "";
    const names = this.schema.enums[kind];
    return names ? names[0] : 0;
  }

  /** @param {string} kind @param {Reader} reader @returns {any} */
  value(kind, reader) {
    switch (kind) {
      case "double": return reader.double();
      case "string": return TEXT.decode(reader.bytes());
      case "fixed64": return reader.fixed64();
      case "sint64": return reader.signed();
      case "bool": return reader.varint() !== 0;
      case "uint32": case "uint64": return reader.varint();
    }
    const names = this.schema.enums[kind];
    if (names) {
      const code = reader.varint();
      return names[code] ?? `${kind} ${code}`;
    }
    return this.decode(kind, reader.bytes());
  }
}

/** @param {string} kind */
const isPacked = (kind) => ["double", "fixed64", "sint64", "uint32", "uint64", "bool"].includes(kind);

/** Reader of protobuf's wire format. Integers above 2^53 lose precision; the page shows none. */
class Reader {
  /** @param {Uint8Array} bytes */
  constructor(bytes) {
    this.all = bytes;
    this.at = 0;
    this.view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  }

  isAtEnd() {
    return this.at >= this.all.length;
  }

  varint() {
    let value = 0;
    for (let factor = 1, n = 0; n < 10; n++, factor *= 128) {
      const byte = this.all[this.at++];
      if (byte === undefined) throw new Error("truncated message");
      value += (byte & 127) * factor;
      if (byte < 128) return value;
    }
    throw new Error("varint too long");
  }

  signed() {
    const value = this.varint();
    return value % 2 === 0 ? value / 2 : -(value + 1) / 2;
  }

  double() {
    this.at += 8;
    return this.view.getFloat64(this.at - 8, true);
  }

  fixed64() {
    this.at += 8;
    return Number(this.view.getBigUint64(this.at - 8, true));
  }

  bytes() {
    const length = this.varint();
    const end = this.at + length;
    if (end > this.all.length) throw new Error("truncated message");
    const bytes = this.all.subarray(this.at, end);
    this.at = end;
    return bytes;
  }

  /** @param {number} type */
  skip(type) {
    if (type === VARINT) this.varint();
    else if (type === FIXED64) this.at += 8;
    else if (type === BYTES) this.bytes();
    else if (type === FIXED32) this.at += 4;
    else throw new Error(`unknown wire type ${type}`);
  }
}

/** @param {number} value @param {number[]} out */
function varint(value, out) {
  while (value >= 128) {
    out.push((value % 128) + 128);
    value = Math.floor(value / 128);
  }
  out.push(value);
}
