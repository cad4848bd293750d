"""The MuJoCo test scene as a Gymnasium environment (about 8 s; needs the extra `reality`).

    python examples/06_gymnasium_loop.py

An episode is one action, carried out to its end by the arm. The reward is minus the distance from
the goal in metres. A random agent and a shipped policy play the same episodes.
"""

import gymnasium
import numpy as np

import gendom.reality  # noqa: F401  registers the environments
from gendom import Policy
from gendom.reality import find_object


def main(episodes: int = 2) -> None:
    """Play.

    Args:
        episodes: Number of episodes.
    """
    env = gymnasium.make("gendom/RopeCasting-v0", parameters=True)
    policy = Policy.pretrained("rope-casting")
    env.action_space.seed(0)
    rewards = []
    for seed in range(episodes):
        observation, info = env.reset(seed=seed)
        rope = find_object(info["object"])
        _, random_reward, *_ = env.step(env.action_space.sample())
        env.reset(seed=seed)  # the same object and goal again
        action = policy.act(observation["goal"], rope)
        _, reward, terminated, _, info = env.step(np.array(action.values))
        assert terminated
        rewards.append((random_reward, reward))
        print(f"{rope.name}, goal {observation['goal'].round(3)} m:", end=" ")
        print(f"random {1e3 * float(random_reward):.1f}, policy {1e3 * float(reward):.1f}", end="")
        print(f" (reward x 1000), reached {info['reached'].round(3)} m")
    print("mean reward, random and policy:", np.mean(rewards, axis=0).round(4))
    env.close()


if __name__ == "__main__":
    main()
