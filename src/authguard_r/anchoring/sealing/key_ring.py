# SPDX-License-Identifier: Apache-2.0
"""What one reader can open of a log.

Spec page: docs/spec/sealed-fields.md#reading
"""

from __future__ import annotations

import msgspec

from authguard_r.anchoring.sealing.wraps import Wrapped, WrappedFor
from authguard_r.audit.record import WRAP, LogRow, Record, read_record, read_sealed
from authguard_r.audit.sealed_envelopes import SEALING, opened
from authguard_r.core.encoding import encode, unb64
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import RobotId
from authguard_r.core.mission import DataClass
from authguard_r.keys.readers import ReaderKey


class KeyRing:
    """What one reader can open of a log that is read from its beginning on.

    Args:
        key: the reader's.
    """

    def __init__(self, key: ReaderKey) -> None:
        self._key = key
        self._robot = RobotId("")
        self._found: dict[tuple[int, DataClass], bytes] = {}
        #: Records with keys for this reader.
        self.records = 0

    def opened(self, row: LogRow) -> LogRow:
        """Return the row as it would be had nothing been sealed, as far as this key goes.

        Raises:
            MalformedError: it is no record, or not what was sealed.
            AuthenticityError: what was wrapped for this key does not open.
        """
        if row.seq == 0 or WRAP.encode() in row.sealed:
            self._learn(row)
        return opened(row, robot=self._robot, key_of=self._of)

    def _of(self, keys: int, data: DataClass) -> bytes | None:
        return self._found.get((keys, data))

    def _learn(self, row: LogRow) -> None:
        where = f"record {row.seq}"
        record = read_record(row.record, where=where)
        if row.seq == 0:
            self._robot = RobotId(str(record.open.get("robot")))
        if record.kind == SEALING:
            found = dict(_unwrapped(row, record, self._robot, self._key))
            self._found |= found
            self.records += bool(found)


def _unwrapped(
    row: LogRow, record: Record, robot: RobotId, key: ReaderKey
) -> list[tuple[tuple[int, DataClass], bytes]]:
    found: list[tuple[tuple[int, DataClass], bytes]] = []
    for name, one in read_sealed(row.sealed, where=f"record {row.seq}").items():
        where = f"record {row.seq}: {name}"
        try:
            data = DataClass(name.removeprefix(WRAP))
            wraps = msgspec.convert(one.value, list[Wrapped])
        except (msgspec.ValidationError, ValueError) as error:
            raise MalformedError(f"expected wrapped keys: {error}", where=where) from error
        for wrapped in wraps:
            if wrapped.reader == key.public.name:
                bound = WrappedFor(
                    robot=robot, mid=record.link.mid, keys=row.seq, data=data, reader=wrapped.reader
                )
                secret = key.unwrap(unb64(wrapped.text, where=where), encode(bound), where=where)
                found.append(((row.seq, data), secret))
    return found
