// SPDX-License-Identifier: Apache-2.0
// Finds the values that lie beside no record any more, though the record is committed to them.
// The rule: docs/spec/audit-record.md#missing.

/** What is missing, as "mission name", with the last record that has lost it. */
export const gone = new Map();

// A record with boxes keeps the values of people in them; only these lie open beside it.
const OPEN = /^(box|wrap)\.|^(now|site|safety|policy|list)$/;

/**
 * Note what one record has lost. An order to destroy explains what lay in boxes before it, if the
 * checkpoint covers the order: `signed` is the checkpoint's size.
 */
export function note({ link, committed, kind, open }, sealed, signed) {
  const names = Object.keys(committed);
  const boxed = names.some((name) => name.startsWith("box."));
  for (const name of names) {
    if (Object.hasOwn(sealed, name) || (boxed && !OPEN.test(name))) continue;
    gone.set(`${link.mid} ${name}`, link.seq);
  }
  if (kind !== "management" || link.decision !== "shred" || link.seq >= signed || !Array.isArray(open.classes)) return;
  for (const key of gone.keys()) {
    const [mid, data] = key.split(/ (?:box|wrap)\./);
    const ordered = data?.split("+").some((one) => open.classes.includes(one));
    if (ordered && mid === open.of) gone.delete(key);
  }
}
