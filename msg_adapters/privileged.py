"""Privileged topics: BEV masks, ego vector, signals, transitions, advice. For training only; the planner cannot import
this. The actors are in `msg_adapters.privileged_actors`."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msg_adapters.factory import MessageFactory, fill_bytes
from msg_adapters.named_values import flag, named_values_from_message, named_values_to_message
from msg_adapters.sensors import BASE_FRAME
from msg_adapters.stamps import set_stamp, stamp_ns
from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.contracts.privileged import (
    BEV_SHAPE,
    Advice,
    PrivilegedFrame,
    Transition,
    check_advice,
    check_bev,
    check_ego,
    check_signals,
)
from raw2drive_ros.tables.vector_layout import (
    BASIC_EGO_FIELDS,
    EGO_FIELDS,
    ROUTE_ERROR_FIELDS,
    SIGNAL_FIELDS,
)

_FORMAT = re.compile(r'bev_bits; shape=(\d+)x(\d+)x(\d+); packing=channel_major_msb_first')
_TERM_PREFIX = 'reward/'


def bev_to_message(factory: MessageFactory, bev: NDArray[np.bool_], time_ns: int) -> Any:
    """(C, H, W) masks as one bit each; `format` names the shape and the packing."""
    # Per channel; where channels are whole bytes that is the same as all at once, which is faster.
    whole = bev[0].size % 8 == 0
    packed = np.packbits(bev) if whole else np.packbits(bev.reshape(bev.shape[0], -1), axis=1)
    message = factory.new('sensor_msgs/msg/CompressedImage')
    set_stamp(message.header.stamp, time_ns)
    message.header.frame_id = BASE_FRAME
    shape = 'x'.join(str(n) for n in bev.shape)
    message.format = f'bev_bits; shape={shape}; packing=channel_major_msb_first'
    message.data = factory.byte_buffer(packed.size)
    fill_bytes(message.data, packed)
    return message


def bev_from_message(message: Any) -> NDArray[np.bool_]:
    """(C, H, W) bool. Raises ContractError for another format, shape or size."""
    matched = _FORMAT.fullmatch(message.format)
    if not matched:
        raise ContractError(f'BEV masks: unknown format {message.format!r}')
    channels, height, width = (int(n) for n in matched.groups())
    if (channels, height, width) != BEV_SHAPE:
        raise ContractError(f'BEV masks: {channels}x{height}x{width}, not {"x".join(map(str, BEV_SHAPE))}')
    packed = np.frombuffer(message.data, np.uint8)
    if packed.size != channels * ((height * width + 7) // 8):
        raise ContractError(f'BEV masks: {packed.size} bytes for {channels}x{height}x{width}')
    bits = np.unpackbits(packed.reshape(channels, -1), axis=1, count=height * width)
    return check_bev(bits.view(np.bool_).reshape(channels, height, width))


def ego_to_message(factory: MessageFactory, frame: PrivilegedFrame) -> Any:
    """The ego vector as a JointState with the names `EGO_FIELDS`, in `base_link`."""
    # A frame of an old bag has the first five.
    values = dict(zip(EGO_FIELDS, (float(v) for v in frame.ego), strict=False))
    return named_values_to_message(factory, values, frame.stamp_ns, BASE_FRAME)


def ego_from_message(message: Any) -> NDArray[np.float32]:
    """(7,) in the order of `EGO_FIELDS`, (5,) where the message is of an old bag, which has no `ROUTE_ERROR_FIELDS`.

    Raises ContractError where a field is missing or out of range.
    """
    values = named_values_from_message(message, *BASIC_EGO_FIELDS)
    old = not any(name in values for name in ROUTE_ERROR_FIELDS)
    fields = BASIC_EGO_FIELDS if old else EGO_FIELDS
    if missing := [name for name in fields if name not in values]:
        raise ContractError(f'ego vector: missing {", ".join(missing)}')
    return check_ego(np.array([values[name] for name in fields], np.float32))


def signals_to_message(factory: MessageFactory, signals: NDArray[np.float32], time_ns: int) -> Any:
    """The signals as a JointState with the names `SIGNAL_FIELDS`, in `base_link`."""
    values = dict(zip(SIGNAL_FIELDS, (float(v) for v in signals), strict=True))
    return named_values_to_message(factory, values, time_ns, BASE_FRAME)


def signals_from_message(message: Any) -> NDArray[np.float32]:
    """(11,) in the order of `SIGNAL_FIELDS`. Raises ContractError where a field is missing or impossible."""
    values = named_values_from_message(message, *SIGNAL_FIELDS)
    return check_signals(np.array([values[name] for name in SIGNAL_FIELDS], np.float32))


def privileged_from_messages(bev: Any, ego: Any) -> PrivilegedFrame:
    """Raises ContractError when the stamps differ or anything is missing or out of range."""
    time_ns = stamp_ns(bev.header.stamp)
    if stamp_ns(ego.header.stamp) != time_ns:
        raise ContractError('privileged frame: BEV and ego vector have different stamps')
    return PrivilegedFrame(time_ns, bev_from_message(bev), ego_from_message(ego))


def advice_to_message(factory: MessageFactory, advice: Advice) -> Any:
    """The expert's action for the frame of that stamp; its reason, if it says one, is the header's frame_id."""
    return named_values_to_message(
        factory, {'action': float(advice.action)}, advice.stamp_ns, advice.reason or BASE_FRAME
    )


def advice_from_message(message: Any) -> Advice:
    """Raises ContractError where the field is missing or no action of the table, or for an impossible reason."""
    action = named_values_from_message(message, 'action')['action']
    reason = str(message.header.frame_id)
    # Without a reason, and in old bags, it is the frame.
    reason = '' if reason == BASE_FRAME else reason
    return Advice(stamp_ns(message.header.stamp), check_advice(action), reason).validate()


def transition_to_message(factory: MessageFactory, transition: Transition, episode: str) -> Any:
    """episode: 'scenario/seed', kept in the header's frame_id."""
    values = {
        'action': float(transition.action),
        'reward': transition.reward,
        'is_first': float(transition.is_first),
        'is_terminal': float(transition.is_terminal),
        'is_last': float(transition.is_last),
    }
    values |= {_TERM_PREFIX + name: value for name, value in transition.reward_terms.items()}
    return named_values_to_message(factory, values, transition.stamp_ns, episode)


def transition_from_message(message: Any) -> tuple[Transition, str]:
    """(transition, 'scenario/seed'). Raises ContractError where a field is missing or out of range."""
    values = named_values_from_message(message, 'action', 'reward', 'is_first', 'is_terminal', 'is_last')
    terms = {name.removeprefix(_TERM_PREFIX): value for name, value in values.items() if name.startswith(_TERM_PREFIX)}
    action = values['action']
    if action != int(action):
        raise ContractError(f'transition: action is {action:g}, not a whole number')
    transition = Transition(
        stamp_ns(message.header.stamp),
        int(action),
        values['reward'],
        terms,
        flag(values, 'is_first'),
        flag(values, 'is_terminal'),
        flag(values, 'is_last'),
    )
    return transition.validate(), str(message.header.frame_id)
