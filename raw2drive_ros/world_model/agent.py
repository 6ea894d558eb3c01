"""The step from observation to action, once for everybody: planner node, evaluators, replay and collectors call it.

Also what a world model imagines without looking: open loop, by the prior alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from raw2drive_ros.world_model.actor_critic import Actor
from raw2drive_ros.world_model.distributions import class_one_hot
from raw2drive_ros.world_model.rssm import Rssm, State
from raw2drive_ros.world_model.streams import WorldModel


class Observation(NamedTuple):
    """What a stream sees of one tick, for B cars.

    view: of the raw stream (B, views, H, W, 3) uint8 images, of the privileged one (B, C*P*P, G, G) masks.
    vector: (B, V), in the order of `vector_layout.VECTOR_FIELDS` or `EGO_FIELDS`.
    """

    view: Tensor
    vector: Tensor


@dataclass(frozen=True, slots=True)
class AgentState:
    """What an agent carries from one decision to the next, for B cars.

    latent: filtered state, (B, ...). action: (B, A) one-hot of the action taken last, zero at the start of an episode.
    """

    latent: State
    action: Tensor

    def acted(self, action: Tensor) -> AgentState:
        """The same state, when `action` (B,) is taken instead of the one that the agent chose."""
        return replace(self, action=class_one_hot(action, self.action.shape[-1]))


class Choice(NamedTuple):
    """action: (B,) int64, the most probable one. log_probs: (B, A)."""

    action: Tensor
    log_probs: Tensor


class RecurrentAgent:
    """Encoder, RSSM and actor of one stream, deterministic: modes instead of samples.

    The weights must not change afterwards: maps of the recurrent loop are made once.
    """

    def __init__(self, model: WorldModel, actor: Actor) -> None:
        self.model, self.actor = model.eval(), actor.eval()
        with torch.inference_mode():
            self._maps = model.rssm.plain_maps()

    def initial(self, batch: int = 1) -> AgentState:
        """The state at the start of an episode."""
        latent = self.model.rssm.initial(batch)
        return AgentState(latent, torch.zeros(batch, self.actor.actions, device=latent.deter.device))

    @torch.inference_mode()
    def step(self, observation: Observation, state: AgentState) -> tuple[Choice, AgentState]:
        """Filter one observation and choose; the new state assumes that the choice is taken (`AgentState.acted`)."""
        model, rssm = self.model, self.model.rssm
        embed = model.embed(*model.encode(observation.view, observation.vector))
        deter = rssm.step_deter(state.latent, state.action, self._maps)
        posterior = rssm.posterior(deter, rssm.post_embed(embed))
        latent = State(deter, class_one_hot(posterior.argmax(-1), posterior.shape[-1]).flatten(-2))
        log_probs = self.actor(latent.feature)
        action = log_probs.argmax(-1)
        return Choice(action, log_probs), AgentState(latent, class_one_hot(action, log_probs.shape[-1]))

    @torch.inference_mode()
    def reconstruct(self, state: AgentState) -> Tensor:
        """(B, C*P*P, G, G) mask probabilities that the model believes in: for pictures, not for driving."""
        return torch.sigmoid(self.model.decoder(state.latent.feature))


def imagine_open_loop(
    rssm: Rssm,
    start: State,
    actions: Tensor | Callable[[int, State], Tensor],
    uniforms: Iterable[Tensor],
    is_first: Tensor | None = None,
) -> Iterator[State]:
    """The prior alone: the states (B, ...) after each step, one per element of `uniforms`.

    start: (B, ...). actions: (B, K, A) one-hot, each the action that LEADS to its step, or a policy that gets the step
    and the state before it. uniforms: (B, S) in [0, 1) for each step. is_first: (B, K) bool; the state is
    reset where a recorded sequence starts an episode.
    """
    state, maps = start, rssm.plain_maps()
    for step, uniform in enumerate(uniforms):
        action = actions[:, step] if isinstance(actions, Tensor) else actions(step, state)
        if is_first is not None:
            keep = (~is_first[:, step]).to(action.dtype).unsqueeze(-1)
            state, action = State(state.deter * keep, state.stoch * keep), action * keep
        deter = rssm.step_deter(state, action, maps)
        state = State(deter, rssm.sample(rssm.prior(deter), uniform))
        yield state
