"""Recurrent state-space model: block-GRU deterministic state, categorical stochastic state (DreamerV3).

h_t = f(h_{t-1}, s_{t-1}, a_{t-1});  posterior q(s_t | h_t, e_t);  prior p(s_t | h_t).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from raw2drive_ros.world_model.config import ModelConfig
from raw2drive_ros.world_model.deferred import DeferredLinear
from raw2drive_ros.world_model.distributions import mixed_log_probs, sample_classes, sample_one_hot, straight_through
from raw2drive_ros.world_model.layers import BlockLinear, Dense, Linear, RmsNorm, ToCells
from raw2drive_ros.world_model.one_hot_indices import OneHotIndices, SparseFeature, worthwhile


@dataclass(slots=True)
class State:
    """deter: (..., D). stoch: (..., S*K), one-hot per group (straight-through while training)."""

    deter: Tensor
    stoch: Tensor

    @property
    def feature(self) -> Tensor:
        """(..., D + S*K): what every head reads."""
        return torch.cat([self.deter, self.stoch], -1)

    def detach(self) -> State:
        return State(self.deter.detach(), self.stoch.detach())


@dataclass(slots=True)
class SparseState:
    """A `State` whose sample needs no gradient, with its one-hot groups as indices."""

    deter: Tensor
    stoch: OneHotIndices

    @property
    def feature(self) -> SparseFeature:
        """`State.feature`, with the stochastic part as indices."""
        return SparseFeature(self.deter, self.stoch)


Map = Callable[[Tensor], Tensor]


@dataclass(slots=True)
class Maps:
    """The linear maps of one step, as the modules themselves or with deferred weight gradients."""

    deter: Map
    stoch: Callable[[Tensor | OneHotIndices], Tensor]
    core_own: Map
    core_shared: Map
    core_gates: Map
    post_deter: Map
    post_out: Map


class CellEmbed(nn.Module):
    """What each cell's posterior reads of an embedding (..., E*G*G + W): its own E features and the whole vector."""

    def __init__(self, config: ModelConfig, hidden: int) -> None:
        super().__init__()
        self.shape = (config.grid_features, config.grid**2)
        self.cell = Linear(config.grid_features, hidden)
        self.vector = Linear(config.vector_features, hidden)

    def forward(self, embed: Tensor) -> Tensor:
        """(..., E*G*G + W) -> (..., G*G*hidden)."""
        features, cells = self.shape
        grid = embed[..., : features * cells].unflatten(-1, self.shape).transpose(-1, -2)
        hidden = self.cell(grid) + self.vector(embed[..., features * cells :]).unsqueeze(-2)
        return hidden.flatten(-2)


class Rssm(nn.Module):
    def __init__(self, config: ModelConfig, embed_size: int, actions: int) -> None:
        super().__init__()
        self.config = config
        c = config
        if c.deter % c.blocks:
            raise ValueError(f'deter {c.deter} is not a multiple of blocks {c.blocks}')
        self.input_deter = Dense(c.deter, c.hidden)
        self.input_stoch = Dense(c.stoch_size, c.hidden)
        self.input_action = Dense(actions, c.hidden)
        self.core_hidden = BlockLinear(c.blocks, c.deter // c.blocks + 3 * c.hidden, c.deter // c.blocks)
        self.core_norm = RmsNorm(c.deter)
        self.core_gates = BlockLinear(c.blocks, c.deter // c.blocks, 3 * c.deter // c.blocks)
        self.prior_net = nn.Sequential(
            Dense(c.deter, c.hidden), Dense(c.hidden, c.hidden), Linear(c.hidden, c.stoch_size)
        )
        if c.latent == 'grid':
            cells = c.grid**2
            self.post_embed: nn.Module = CellEmbed(c, c.cell_hidden)
            self.post_deter: nn.Module = ToCells(c.deter, c.spread, cells, c.cell_hidden)
            self.post_norm = RmsNorm(c.cell_hidden)
            self.post_out = Linear(c.cell_hidden, c.stoch_size // cells)
        else:
            self.post_embed = Linear(embed_size, c.hidden)
            self.post_deter = Linear(c.deter, c.hidden)
            self.post_norm = RmsNorm(c.hidden)
            self.post_out = Linear(c.hidden, c.stoch_size)

    def initial(self, batch: int) -> State:
        c = self.config
        device = self.post_out.weight.device
        return State(torch.zeros(batch, c.deter, device=device), torch.zeros(batch, c.stoch_size, device=device))

    def maps(self) -> Maps:
        """The maps for one pass over a sequence; while gradients are recorded, with deferred weight gradients."""
        if not torch.is_grad_enabled() or not self.post_out.weight.requires_grad:
            return self.plain_maps()
        inputs = (self.input_deter.linear, self.input_stoch.linear)
        deter, dense_stoch = (DeferredLinear(layer.weight.t(), layer.bias) for layer in inputs)

        def stoch(x: Tensor | OneHotIndices) -> Tensor:
            # While gradients are recorded samples are dense, because gradients flow through them.
            assert isinstance(x, Tensor)
            return dense_stoch(x)

        own, shared = self._core_parts()
        core = DeferredLinear(own, None), DeferredLinear(shared, self.core_hidden.bias.flatten())
        gates = DeferredLinear(self.core_gates.weight, self.core_gates.bias)
        if not isinstance(self.post_deter, Linear):
            # The map of a cell is small and has many rows at every step: nothing is gained by deferring.
            return Maps(deter, stoch, *core, gates, self.post_deter, self.post_out)
        post_deter, post_out = (DeferredLinear(m.weight.t(), m.bias) for m in (self.post_deter, self.post_out))
        return Maps(deter, stoch, *core, gates, post_deter, post_out)

    def plain_maps(self) -> Maps:
        """The maps with the present weights; make them once for a loop of steps without gradients."""
        own, shared = self._core_parts()
        bias = self.core_hidden.bias.flatten()
        return Maps(
            self.input_deter.linear,
            self.input_stoch.linear,
            lambda x: torch.bmm(x, own),
            lambda x: torch.addmm(bias, x, shared),
            self.core_gates,
            self.post_deter,
            self.post_out,
        )

    def _core_parts(self) -> tuple[Tensor, Tensor]:
        """Weights of `core_hidden`: (blocks, I, O) of each block's own state, (3*hidden, D) of what all blocks read.

        The latter are applied in one product, without a copy of these inputs for every block.
        """
        weight, size = self.core_hidden.weight, self.config.deter // self.config.blocks
        return weight[:, :size], weight[:, size:].transpose(0, 1).flatten(1)

    def step_deter(self, state: State | SparseState, action: Tensor, maps: Maps | None = None) -> Tensor:
        """h_t, (B, D), from the state before it and one-hot actions (B, A). maps: `plain_maps()`, made once."""
        return self.next_deter(state, self.input_action(action), maps or self.plain_maps())

    def next_deter(self, state: State | SparseState, action_hidden: Tensor, maps: Maps) -> Tensor:
        """h_t, (B, D), where `action_hidden` is `input_action(a)`, (B, hidden)."""
        c = self.config
        batch = state.deter.shape[0]
        silu = nn.functional.silu
        deter_hidden = silu(self.input_deter.norm(maps.deter(state.deter)))
        stoch_hidden = silu(self.input_stoch.norm(maps.stoch(state.stoch)))
        inputs = torch.cat([deter_hidden, stoch_hidden, action_hidden], -1)
        own = maps.core_own(state.deter.view(batch, c.blocks, -1).transpose(0, 1))
        x = maps.core_shared(inputs) + own.transpose(0, 1).reshape(batch, -1)
        x = silu(self.core_norm(x))
        gates = maps.core_gates(x.view(batch, c.blocks, -1).transpose(0, 1))
        reset, candidate, update = (gate.transpose(0, 1).reshape(batch, -1) for gate in gates.chunk(3, -1))
        update = torch.sigmoid(update - 1.0)
        candidate = torch.tanh(torch.sigmoid(reset) * candidate)
        return update * candidate + (1.0 - update) * state.deter

    def prior(self, deter: Tensor) -> Tensor:
        """(..., S, K) log-probabilities of p(s | h)."""
        return self._log_probs(self.prior_net(deter))

    def posterior(self, deter: Tensor, embed_hidden: Tensor, maps: Maps | None = None) -> Tensor:
        """(..., S, K) log-probabilities of q(s | h, e); `embed_hidden` is `post_embed(e)`."""
        to_hidden, to_logits = (maps.post_deter, maps.post_out) if maps else (self.post_deter, self.post_out)
        hidden = to_hidden(deter) + embed_hidden
        if self.config.latent == 'grid':
            hidden = hidden.unflatten(-1, (-1, self.config.cell_hidden))
            return self._log_probs(to_logits(nn.functional.silu(self.post_norm(hidden))).flatten(-2))
        return self._log_probs(to_logits(nn.functional.silu(self.post_norm(hidden))))

    def _log_probs(self, logits: Tensor) -> Tensor:
        shape = (*logits.shape[:-1], self.config.stoch, self.config.classes)
        return mixed_log_probs(logits.view(shape), self.config.unimix)

    def sample(self, log_probs: Tensor, uniform: Tensor) -> Tensor:
        """(..., S, K) and (..., S) -> (..., S*K) straight-through sample."""
        one_hot = sample_one_hot(log_probs, uniform)
        if log_probs.requires_grad:
            one_hot = straight_through(one_hot, log_probs)
        return one_hot.flatten(-2)

    def sparse(self, state: State) -> State | SparseState:
        """For steps without gradients: the state, with its sample as indices where that is faster."""
        classes = self.config.classes
        return SparseState(state.deter, OneHotIndices.of(state.stoch, classes)) if worthwhile(classes) else state

    def imagine(self, deter: Tensor, uniform: Tensor) -> State | SparseState:
        """The state of h_t, (B, D), and a sample of its prior, without gradients; sparse where that is faster."""
        log_probs, classes = self.prior(deter), self.config.classes
        if worthwhile(classes):
            return SparseState(deter, OneHotIndices.of_classes(sample_classes(log_probs, uniform), classes))
        return State(deter, self.sample(log_probs, uniform))

    def observe(
        self, embed: Tensor, actions: Tensor, is_first: Tensor, uniform: Tensor, start: State | None = None
    ) -> tuple[State, Tensor]:
        """Posterior states of a sequence.

        embed: (B, T, E*G*G + W). actions: (B, T, A), the action that LED to step t. is_first: (B, T) bool.
        uniform: (B, T, S). Returns states (B, T, ...) and posterior log-probabilities (B, T, S, K).
        """
        state = start or self.initial(embed.shape[0])
        hidden = self.post_embed(embed)
        keep = (~is_first).to(embed.dtype).unsqueeze(-1)
        acted = self.input_action(actions * keep)
        maps = self.maps()
        deters, stochs, posts = [], [], []
        for t in range(embed.shape[1]):
            mask = keep[:, t]
            state = State(state.deter * mask, state.stoch * mask)
            deter = self.next_deter(state, acted[:, t], maps)
            post = self.posterior(deter, hidden[:, t], maps)
            state = State(deter, self.sample(post, uniform[:, t]))
            deters.append(deter)
            stochs.append(state.stoch)
            posts.append(post)
        return State(torch.stack(deters, 1), torch.stack(stochs, 1)), torch.stack(posts, 1)
