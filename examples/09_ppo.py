"""Proximal policy optimisation in the vectorised environment of rope reaching (extras `train` and
`reality`; about 2 minutes on two cores).

    python examples/09_ppo.py

An episode has 40 steps: the hand moves and lets go, and the reward at its end is minus the distance
of what the rope's tip reached from the goal, in lengths of the rope. Each world has its own rope
and goal; the policy sees both. PPO (Schulman et al., 2017) in plain PyTorch, to be taken apart.
"""

from typing import Any

import gymnasium
import numpy as np
import torch
import tyro
from torch import nn

CLIP, EPOCHS, BATCHES, LAMBDA, ENTROPY = 0.2, 6, 4, 0.97, 1e-3


def network(sees: int, gives: int) -> nn.Sequential:
    """Two hidden layers."""
    inner = (nn.Linear(sees, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh())
    return nn.Sequential(*inner, nn.Linear(64, gives))


class Agent(nn.Module):
    """Gaussian actions, whose deviation does not depend on what is seen, and a value."""

    def __init__(self, sees: int, acts: int):
        super().__init__()
        self.mean, self.value = network(sees, acts), network(sees, 1)
        self.log_sd = nn.Parameter(torch.full((acts,), -0.5))
        last: Any = self.mean[-1]
        with torch.no_grad():
            last.weight *= 0.01
            last.bias[-1] = 0.5  # hold on at first

    def acts(self, seen: torch.Tensor) -> torch.distributions.Normal:
        """Its actions, after what is seen."""
        return torch.distributions.Normal(self.mean(seen), self.log_sd.exp())


class Scale:
    """Running mean and deviation of what is seen."""

    def __init__(self, size: int):
        self.count, self.mean, self.square = 1e-4, np.zeros(size), np.ones(size)

    def __call__(self, seen: np.ndarray, *, learn: bool = True) -> torch.Tensor:
        if learn:
            self.count += len(seen)
            share = len(seen) / self.count
            self.mean += share * (seen.mean(axis=0) - self.mean)
            self.square += share * ((seen**2).mean(axis=0) - self.square)
        sd = np.sqrt(np.maximum(self.square - self.mean**2, 1e-6))
        return torch.as_tensor(np.clip((seen - self.mean) / sd, -5.0, 5.0), dtype=torch.float32)


def played(envs, agent: Agent, scale: Scale, steps: int):
    """One episode of each world: what was seen, done, its log-probability and value, rewards."""
    seen, rows = envs.reset()[0], []
    for _ in range(steps):
        with torch.no_grad():
            at = scale(seen)
            normal = agent.acts(at)
            action = normal.sample()
            row = [at, action, normal.log_prob(action).sum(-1), agent.value(at)[:, 0]]
        seen, reward, *_ = envs.step(action.numpy())
        rows.append([*row, torch.as_tensor(reward, dtype=torch.float32)])
    return [torch.stack(column) for column in zip(*rows, strict=True)]


def advantages(reward: torch.Tensor, value: torch.Tensor) -> torch.Tensor:
    """Generalised advantages [T, W] of episodes that end after the last step, undiscounted."""
    after = torch.cat([value[1:], torch.zeros_like(value[:1])])
    error, found, last = reward + after - value, torch.zeros_like(reward), 0.0
    for t in reversed(range(len(reward))):
        found[t] = last = error[t] + LAMBDA * last
    return found


def improve(agent: Agent, optimiser: torch.optim.Optimizer, rows: list[torch.Tensor]) -> None:
    """Some epochs over what was played."""
    seen, action, before, value, reward = rows
    gain = advantages(reward, value)
    wanted = (gain + value).flatten()
    gain = ((gain - gain.mean()) / (gain.std() + 1e-6)).flatten()
    seen, action, before = seen.flatten(0, 1), action.flatten(0, 1), before.flatten()
    for _ in range(EPOCHS):
        for some in torch.randperm(len(seen)).chunk(BATCHES):
            normal = agent.acts(seen[some])
            ratio = (normal.log_prob(action[some]).sum(-1) - before[some]).exp()
            clipped = ratio.clamp(1.0 - CLIP, 1.0 + CLIP)
            loss = -torch.minimum(ratio * gain[some], clipped * gain[some]).mean()
            loss = loss + 0.5 * (agent.value(seen[some])[:, 0] - wanted[some]).square().mean()
            loss = loss - ENTROPY * normal.entropy().sum(-1).mean()
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
            optimiser.step()


def main(iterations: int = 60, worlds: int = 128, seed: int = 0) -> list[float]:
    """Learn, and return the mean reward of each iteration.

    Args:
        iterations: Times that all worlds are played.
        worlds: Ropes side by side.
        seed: Of objects, goals, actions and the networks.
    """
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    name = "gendom.environments:gendom/RopeReachingSteps-v0"
    envs = gymnasium.make_vec(name, num_envs=worlds, parameters=True)
    envs.reset(seed=seed)
    sees = int(np.prod(envs.single_observation_space.shape or ()))
    acts = int(np.prod(envs.single_action_space.shape or ()))
    agent, scale, curve = Agent(sees, acts), Scale(sees), []
    optimiser = torch.optim.Adam(agent.parameters(), lr=1e-3)
    for k in range(iterations):
        rows = played(envs, agent, scale, steps=40)
        improve(agent, optimiser, rows)
        curve.append(float(rows[-1].sum(0).clamp(min=-2.0).mean()))
        print(f"{k + 1:4d}  mean miss {-curve[-1]:.3f} lengths", flush=True)
    return curve


if __name__ == "__main__":
    tyro.cli(main)
