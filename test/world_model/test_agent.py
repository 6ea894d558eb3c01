"""One step for everybody: the same for one car and for many, and imagination that follows it."""

import pytest
import torch

from raw2drive_ros.contracts.actions import ACTION_COUNT
from raw2drive_ros.tables.vector_layout import EGO_SIZE
from raw2drive_ros.training.config import make_config
from raw2drive_ros.world_model.actor_critic import Actor
from raw2drive_ros.world_model.agent import Observation, RecurrentAgent, imagine_open_loop
from raw2drive_ros.world_model.distributions import class_one_hot
from raw2drive_ros.world_model.rssm import State
from raw2drive_ros.world_model.streams import PrivilegedWorldModel

TICKS, CARS = 6, 3


@pytest.fixture(scope='module', params=['nano', 'laptop'])
def agent(request) -> RecurrentAgent:
    """With weights that matter: a new actor's output layer is nearly zero."""
    torch.manual_seed(0)
    config = make_config(request.param).model
    actor = Actor(config, ACTION_COUNT)
    torch.nn.init.normal_(actor.net[-1].weight, std=0.5)
    return RecurrentAgent(PrivilegedWorldModel(config, EGO_SIZE, ACTION_COUNT), actor)


@pytest.fixture(scope='module')
def observations(agent) -> list[Observation]:
    c = agent.model.config
    shape = (CARS, len(c.mask_classes) * c.patch**2, c.grid, c.grid)
    generator = torch.Generator().manual_seed(1)
    return [
        Observation((torch.rand(shape, generator=generator) < 0.2).float(), torch.rand(CARS, EGO_SIZE) * 10.0)
        for _ in range(TICKS)
    ]


def test_many_cars_at_once_decide_as_each_alone(agent, observations) -> None:
    state, together = agent.initial(CARS), []
    for observation in observations:
        choice, state = agent.step(observation, state)
        together.append(choice.action)
    assert len(set(torch.stack(together).flatten().tolist())) > 1, 'a constant agent proves nothing'
    for car in range(CARS):
        alone = agent.initial()
        for tick, (view, vector) in enumerate(observations):
            choice, alone = agent.step(Observation(view[car : car + 1], vector[car : car + 1]), alone)
            assert int(choice.action) == int(together[tick][car])
        assert torch.allclose(alone.latent.deter[0], state.latent.deter[car], atol=1e-4)


def test_the_state_remembers_what_was_done_and_not_what_was_chosen(agent, observations) -> None:
    first, state = agent.step(observations[0], agent.initial(CARS))
    assert torch.equal(state.action, class_one_hot(first.action, ACTION_COUNT))
    other = state.acted((first.action + 1) % ACTION_COUNT)
    assert torch.equal(other.action.argmax(-1), (first.action + 1) % ACTION_COUNT)
    assert torch.equal(other.latent.deter, state.latent.deter)
    left, right = (agent.step(observations[1], s)[1].latent.deter for s in (state, other))
    assert not torch.equal(left, right)


def test_the_past_matters_and_a_new_start_forgets_it(agent, observations) -> None:
    _, state = agent.step(observations[0], agent.initial(CARS))
    later, fresh = (agent.step(observations[1], s)[1].latent.deter for s in (state, agent.initial(CARS)))
    assert not torch.equal(later, fresh)
    again = agent.step(observations[1], agent.initial(CARS))[1].latent.deter
    assert torch.equal(again, fresh)


def test_reconstruction_is_of_the_state(agent, observations) -> None:
    _, state = agent.step(observations[0], agent.initial(CARS))
    masks = agent.reconstruct(state)
    assert masks.shape == observations[0].view.shape
    assert bool((masks >= 0.0).all()) and bool((masks <= 1.0).all())


@torch.no_grad()
def test_open_loop_imagination_is_the_prior_step_by_step(agent) -> None:
    rssm, steps = agent.model.rssm, 4
    start = State(torch.randn(CARS, rssm.config.deter), torch.zeros(CARS, rssm.config.stoch_size))
    actions = class_one_hot(torch.randint(0, ACTION_COUNT, (CARS, steps)), ACTION_COUNT)
    uniforms = [torch.rand(CARS, rssm.config.stoch) for _ in range(steps)]
    is_first = torch.zeros(CARS, steps, dtype=torch.bool)
    is_first[1, 2] = True
    found = list(imagine_open_loop(rssm, start, actions, uniforms, is_first))
    state = start
    for step in range(steps):
        keep = (~is_first[:, step]).float()[:, None]
        deter = rssm.step_deter(State(state.deter * keep, state.stoch * keep), actions[:, step] * keep)
        state = State(deter, rssm.sample(rssm.prior(deter), uniforms[step]))
        assert torch.equal(found[step].deter, state.deter) and torch.equal(found[step].stoch, state.stoch)
    policy = list(imagine_open_loop(rssm, start, lambda step, state: actions[:, step], uniforms))
    assert torch.equal(policy[1].deter, found[1].deter) and not torch.equal(policy[2].deter, found[2].deter)
