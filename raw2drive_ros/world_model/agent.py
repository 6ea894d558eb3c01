"""The step from observation to action, which planner node, evaluators, replay and collector share.

Also open-loop imagination: a world model rolled forward by its prior alone, without observations.
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
    """The inputs of one stream in one tick, for B cars.

    view: raw stream (B, views, height, width, 3) uint8 RGB images, privileged stream (B, C*P*P, G, G) masks.
    vector: (B, V), in the order of `vector_layout.VECTOR_FIELDS` or `ModelConfig.ego_fields`.
    """

    view: Tensor
    vector: Tensor


@dataclass(frozen=True, slots=True)
class AgentState:
    """The recurrent state of an agent between two decisions, for B cars.

    latent: posterior state, (B, ...). action: (B, A) one-hot of the last action, zero at the start of an episode.
    """

    latent: State
    action: Tensor

    def acted(self, action: Tensor) -> AgentState:
        """The same state with `action`, (B,) int64, as the last action instead of the one that the agent chose."""
        return replace(self, action=class_one_hot(action, self.action.shape[-1]))


class Choice(NamedTuple):
    """action: (B,) int64, the most probable one. log_probs: (B, A)."""

    action: Tensor
    log_probs: Tensor


class RecurrentAgent:
    """Encoder, RSSM and actor of one stream, deterministic: modes instead of samples.

    The weights must not change afterwards: the linear maps of the recurrent step are prepared here, once.
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
        """Update the posterior with one observation and choose an action.

        The new state holds the chosen action as the last one; `AgentState.acted` replaces it where another is executed.
        """
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
        """(B, C*P*P, G, G) mask probabilities decoded from the state: for pictures, not for driving."""
        return torch.sigmoid(self.model.decoder(state.latent.feature))


def imagine_open_loop(
    rssm: Rssm,
    start: State,
    actions: Tensor | Callable[[int, State], Tensor],
    uniforms: Iterable[Tensor],
    is_first: Tensor | None = None,
) -> Iterator[State]:
    """Roll forward by the prior alone; yields the state (B, ...) after each step, one per element of `uniforms`.

    start: (B, ...). actions: (B, H, A) one-hot, each the action that LEADS to its step, or a policy that is given the
    number of the step and the state before it and returns (B, A). uniforms: (B, S) in [0, 1) for each step.
    is_first: (B, H) bool, true where a recorded sequence starts an episode; the state is reset there.
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
