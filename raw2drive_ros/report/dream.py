"""What the privileged world model believes and imagines at a moment of a bag, beside the truth, as a video.

Filtering (green border): the posterior of every frame. Imagining (red border): the prior alone, on the recorded actions
or on the policy's own, while the posterior beside it goes on filtering.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor

from msg_adapters.factory import RosbagsFactory
from raw2drive_ros.contracts.actions import ACTION_COUNT
from raw2drive_ros.contracts.errors import BagError
from raw2drive_ros.recording.bag_reader import open_bag, require_topics
from raw2drive_ros.recording.ticks import BagTick, read_advice, read_ticks
from raw2drive_ros.report.panels import FRAME, Rgb, canvas_of, mp4, put, text
from raw2drive_ros.tables.bev_colours import colour_masks
from raw2drive_ros.tables.rates import DECISION_HZ
from raw2drive_ros.world_model.agent import imagine_open_loop
from raw2drive_ros.world_model.config import ModelConfig
from raw2drive_ros.world_model.distributions import class_one_hot, sample_one_hot
from raw2drive_ros.world_model.mask_codec import MaskCodec
from raw2drive_ros.world_model.privileged_inputs import extra_topics, masks_of, vector_of
from raw2drive_ros.world_model.rssm import State
from raw2drive_ros.world_model.teacher import Teacher

WARM_UP_S, SHOWN_BEFORE_S = 5.0, 2.0
SIDE, GAP, PLOT_PX, BORDER = 256, 16, 90, 4
# Frames per second, at one frame per tick: half speed, because three seconds are short.
RATE = 5
WHITE, GREEN, RED = (235, 235, 235), (80, 220, 120), (240, 80, 80)
SIZE = (4 * GAP + 3 * SIDE, GAP + 24 + SIDE + 2 * (PLOT_PX + 2 * GAP))


@dataclass(slots=True)
class Dream:
    """masks: per tick (C, side, side) of truth, posterior and imagination. reward, cont: per tick, by the same three
    names; NaN where there is none. begins: index of the first imagined tick. reasons: of the expert's advice, per tick,
    where the bag holds it."""

    begins: int
    masks: dict[str, list[np.ndarray]] = field(default_factory=dict)
    reward: dict[str, list[float]] = field(default_factory=dict)
    cont: dict[str, list[float]] = field(default_factory=dict)
    reasons: list[str] = field(default_factory=list)


def ticks_around(
    bag: Path, at_s: float, seconds: float, config: ModelConfig | None = None
) -> tuple[list[BagTick], int]:
    """(ticks of the sequence that is running `at_s` after the bag's first tick, index of that moment among them).

    From `WARM_UP_S` before it to `seconds` after it. config: of the model that shall read them, if it needs more than
    masks and ego vector. Raises BagError when no episode continues after that moment, or the bag lacks what is needed.
    """
    extras = () if config is None else extra_topics(config)
    found: list[BagTick] = []
    begins = -1
    first_ns = None
    with open_bag(bag) as reader:
        require_topics(reader, bag, list(extras), 'this model')
        for tick in read_ticks(reader, bag, cameras=False, extras=extras):
            first_ns = tick.stamp_ns if first_ns is None else first_ns
            after_s = (tick.stamp_ns - first_ns) * 1e-9
            if tick.starts_segment and after_s <= at_s:
                found.clear()
            if after_s > at_s + seconds or (tick.starts_segment and after_s > at_s):
                break
            if begins < 0 and after_s >= at_s:
                begins = len(found)
            found.append(tick)
    if begins < 0 or len(found) - begins < 2:
        raise BagError(f'{bag}: no episode goes on after {at_s:.1f} s; see raw2drive bag info for its length')
    skip = max(0, begins - round(WARM_UP_S * DECISION_HZ))
    return found[skip:], begins - skip


def reasons_of(bag: Path, ticks: list[BagTick]) -> list[str]:
    """Why the expert advised what it did, per tick; '' where the bag does not say. Raises BagError."""
    with open_bag(bag) as reader:
        advised = read_advice(reader, RosbagsFactory())
    return [advised[tick.stamp_ns].reason if tick.stamp_ns in advised else '' for tick in ticks]


@torch.no_grad()
def dream(teacher: Teacher, ticks: list[BagTick], begins: int, *, own_actions: bool = False) -> Dream:
    """Filter all ticks; from `begins` on also imagine, on the recorded or on the policy's own actions."""
    codec, stoch = MaskCodec(teacher.config), teacher.config.stoch
    rssm, actor = teacher.model.eval().rssm, teacher.policy.actor.eval()
    generator = torch.Generator().manual_seed(0)
    # Uniform random numbers of each tick: for sampling its state, and the last one for sampling an action.
    uniforms = [torch.rand(1, stoch + 1, generator=generator) for _ in ticks]
    masks = [_masks(codec, tick, teacher.config) for tick in ticks]
    actions = torch.stack([_action(tick) for tick in ticks], 1)
    believed = _filter(teacher, ticks, masks, actions, uniforms)
    start = believed[begins - 1] if begins else rssm.initial(1)
    ahead = uniforms[begins:]

    def own(step: int, state: State) -> Tensor:
        return sample_one_hot(actor(state.feature), ahead[step][:, -1])

    chosen = own if own_actions else actions[:, begins:]
    imagined = list(imagine_open_loop(rssm, start, chosen, (u[:, :-1] for u in ahead)))
    found = Dream(begins)
    for index, (tick, deep) in enumerate(zip(ticks, masks, strict=True)):
        assert tick.transition is not None
        _note(found, 'truth', codec, deep, tick.transition.reward, float(not tick.transition.is_terminal))
        _note(found, 'posterior', codec, *_read(teacher, believed[index]))
        if index < begins:
            _note(found, 'imagined', codec, torch.zeros_like(deep), float('nan'), float('nan'))
        else:
            _note(found, 'imagined', codec, *_read(teacher, imagined[index - begins]))
    return found


def _masks(codec: MaskCodec, tick: BagTick, config: ModelConfig) -> Tensor:
    """(1, C*P*P, G, G) of a tick."""
    assert tick.privileged is not None
    return torch.from_numpy(codec.unpack(codec.pack(masks_of(tick.privileged, config))[None])).float()


def _action(tick: BagTick) -> Tensor:
    """(1, A) one-hot of the action that led to a tick, zero where none did."""
    assert tick.transition is not None
    chosen = tick.transition.action
    return class_one_hot(torch.tensor([max(chosen, 0)]), ACTION_COUNT) * float(chosen >= 0)


def _filter(
    teacher: Teacher, ticks: list[BagTick], masks: list[Tensor], actions: Tensor, uniforms: list[Tensor]
) -> list[State]:
    """The sampled posterior state after each tick."""
    model, rssm = teacher.model, teacher.model.rssm
    state, found = rssm.initial(1), []
    for index, (tick, deep) in enumerate(zip(ticks, masks, strict=True)):
        assert tick.privileged is not None
        vector = torch.from_numpy(vector_of(tick.privileged, teacher.config))[None]
        embed = model.embed(*model.encode(deep, vector))
        deter = rssm.step_deter(state, actions[:, index])
        posterior = rssm.posterior(deter, rssm.post_embed(embed))
        state = State(deter, rssm.sample(posterior, uniforms[index][:, :-1]))
        found.append(state)
    return found


def _read(teacher: Teacher, state: State) -> tuple[Tensor, float, float]:
    model, feature = teacher.model, state.feature
    return torch.sigmoid(model.decoder(feature)), float(model.reward(feature)), float(model.cont(feature))


def _note(found: Dream, name: str, codec: MaskCodec, deep: Tensor, reward: float, cont: float) -> None:
    found.masks.setdefault(name, []).append(codec.to_image_order(deep.numpy())[0])
    found.reward.setdefault(name, []).append(reward)
    found.cont.setdefault(name, []).append(cont)


def overlaps(found: Dream, name: str) -> dict[float, float]:
    """Seconds after the first imagined tick -> overlap (IoU of all classes together) of `name`'s masks with the true
    ones; name: posterior or imagined."""
    after: dict[float, float] = {}
    for index in range(found.begins, len(found.masks['truth'])):
        true, seen = found.masks['truth'][index] > 0.5, found.masks[name][index] > 0.5
        after[round((index - found.begins) / DECISION_HZ, 1)] = float((true & seen).sum() / max((true | seen).sum(), 1))
    return after


def save_dream(target: Path, found: Dream, classes: list[str]) -> Path:
    """An MP4 at half speed, from `SHOWN_BEFORE_S` before the first imagined tick on. Raises OSError."""
    first = max(0, found.begins - round(SHOWN_BEFORE_S * DECISION_HZ))
    target.parent.mkdir(parents=True, exist_ok=True)
    with mp4(target, *SIZE, RATE) as append:
        for index in range(first, len(found.masks['truth'])):
            append(_picture(found, classes, first, index))
    return target


def _picture(found: Dream, classes: list[str], first: int, index: int) -> Rgb:
    canvas = canvas_of(*SIZE)
    dreaming = index >= found.begins
    moment = (index - found.begins) / DECISION_HZ
    titles = {'truth': 'truth', 'posterior': 'posterior', 'imagined': ''}
    if dreaming:
        agrees = {name: overlaps(found, name)[round(moment, 1)] for name in ('posterior', 'imagined')}
        titles |= {name: f'{name}, overlap with truth {share:.2f}' for name, share in agrees.items()}
    for column, (name, title) in enumerate(titles.items()):
        left, top = GAP + column * (SIDE + GAP), GAP + 20
        text(canvas, title, (left, GAP + 8))
        if name == 'imagined' and not dreaming:
            continue
        put(canvas, colour_masks(found.masks[name][index], classes), left, top, SIDE, SIDE, smooth=False)
        colour = RED if name == 'imagined' else GREEN if name == 'posterior' else FRAME
        cv2.rectangle(canvas, (left, top), (left + SIDE - 1, top + SIDE - 1), colour, BORDER)
    text(canvas, f'{moment:+.1f} s', (SIZE[0] - 70, GAP + 8), colour=RED if dreaming else GREEN)
    if found.reasons and found.reasons[index]:
        text(canvas, f'advice: {found.reasons[index]}', (GAP, SIZE[1] - 6))
    text(canvas, f'speed x{RATE / DECISION_HZ:g}', (SIZE[0] - 100, SIZE[1] - 6))
    top = 2 * GAP + 24 + SIDE
    _curves(canvas, 'reward', found.reward, first, index, top)
    _curves(canvas, 'continue', found.cont, first, index, top + PLOT_PX + 2 * GAP, (0.0, 1.05))
    return canvas


def _curves(
    canvas: Rgb,
    title: str,
    series: dict[str, list[float]],
    first: int,
    index: int,
    top: int,
    span: tuple[float, float] | None = None,
) -> None:
    """Recorded (white), read from the posterior (green) and from the imagination (red), up to the tick shown."""
    left, width = GAP, SIZE[0] - 2 * GAP
    values = np.array([series[name][first:] for name in ('truth', 'posterior', 'imagined')])
    low, high = span or (float(np.nanmin(values)) - 0.1, float(np.nanmax(values)) + 0.1)
    cv2.rectangle(canvas, (left, top), (left + width, top + PLOT_PX), FRAME, 1)
    text(canvas, f'{title} {low:.1f} to {high:.1f}', (left + 4, top - 4))
    x = left + np.arange(values.shape[1]) * width / max(1, values.shape[1] - 1)
    for row, colour in zip(values, (WHITE, GREEN, RED), strict=True):
        there = np.flatnonzero(np.isfinite(row[: index - first + 1]))
        y = top + PLOT_PX - (row[there] - low) / max(high - low, 1e-6) * PLOT_PX
        cv2.polylines(
            canvas, [np.stack([x[there], y], 1).astype(np.int32)], isClosed=False, color=colour, lineType=cv2.LINE_AA
        )
