"""What is known of each MAVLink message id: enough to verify, frame and route, not to decode."""

from __future__ import annotations

from dataclasses import dataclass

from groundstation.domain.errors import ResourceError

try:
    from groundstation.mavlink.generated import message_table
except ModuleNotFoundError as error:
    raise ResourceError(
        "the MAVLink dialect has not been generated; run: python -m groundstation.mavlink.generate"
    ) from error


@dataclass(frozen=True, slots=True)
class MessageInfo:
    """One message of the dialect."""

    message_id: int
    name: str
    crc_extra: int
    """Seed that ties the CRC to the message's definition."""
    base_length: int
    """Payload bytes without extension fields: what MAVLink 1 carries."""
    length: int
    """Payload bytes with extension fields, before trailing zeros are cut."""
    target_system_offset: int | None
    """Of the target's system id in the payload; None: the message is for everyone."""
    target_component_offset: int | None


CATALOGUE: dict[int, MessageInfo] = {
    message_id: MessageInfo(message_id, *facts) for message_id, facts in message_table.MESSAGES.items()
}
"""By message id."""
