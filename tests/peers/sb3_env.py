"""One measured run of Stable-Baselines3's DDPG on an environment that costs nothing: all of its loop, no physics."""

import argparse

import bench
import ddpg_work
import gymnasium
import numpy as np
import torch
from stable_baselines3 import DDPG


class Still(gymnasium.Env):
    """56 random observations, a reward, an end after 100 steps; drawn beforehand."""

    observation_space = gymnasium.spaces.Box(-1, 1, (ddpg_work.OBSERVATION,), np.float32)
    action_space = gymnasium.spaces.Box(-1, 1, (ddpg_work.ACTION,), np.float32)

    def __init__(self):
        self.observations = np.random.default_rng(1).uniform(-1, 1, (256, ddpg_work.OBSERVATION)).astype(np.float32)
        self.time = 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.observations[0], {}

    def step(self, action):
        self.time += 1
        return self.observations[self.time % 256], 1.0, False, self.time % 100 == 0, {}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("batch", type=int)
    parser.add_argument("threads", type=int)
    options = parser.parse_args()
    batch = options.batch
    torch.set_num_threads(options.threads)
    model = DDPG(
        "MlpPolicy", Still(), learning_rate=ddpg_work.CRITIC_RATE, buffer_size=ddpg_work.TRANSITIONS,
        learning_starts=batch, batch_size=batch, tau=ddpg_work.TARGET_RATE, gamma=ddpg_work.DISCOUNT,
        train_freq=1, gradient_steps=1, policy_kwargs={"net_arch": list(ddpg_work.HIDDEN)}, device="cpu",
    )  # fmt: skip
    model.learn(batch + 50)
    # Between two steps lies one update; a call of 20 steps hides what `learn` costs to enter.
    steps = 20
    bench.serve(
        lambda: model.learn(steps, reset_num_timesteps=False), steps=steps, how=bench.version("stable-baselines3")
    )


if __name__ == "__main__":
    main()
