"""The work of one DDPG update that all do alike: sizes, rates and a replay memory of 20,000 transitions.

Plain DDPG (Lillicrap et al. 2016): y = r + γ Q′(s′, π′(s′)); the critic's mean squared error; the actor's
−mean Q(s, π(s)); Adam for both; both target copies move by Polyak averaging. Drawing the minibatch belongs to it.
"""

import numpy as np

OBSERVATION, ACTION, HIDDEN = 56, 4, (512, 256)
ACTOR_RATE, CRITIC_RATE, TARGET_RATE, DISCOUNT = 1e-4, 1e-3, 0.005, 0.95
TRANSITIONS = 20_000


def replay(seed=1):
    """Observations, actions, rewards, discounts, next observations; float32."""
    rng = np.random.default_rng(seed)

    def column(width):
        return rng.uniform(-1, 1, (TRANSITIONS, width)).astype(np.float32)

    discounts = np.full((TRANSITIONS, 1), DISCOUNT, dtype=np.float32)
    return column(OBSERVATION), column(ACTION), column(1), discounts, column(OBSERVATION)


def widths(inputs, outputs):
    """Pairs of a network's layer sizes."""
    sizes = (inputs, *HIDDEN, outputs)
    return list(zip(sizes[:-1], sizes[1:], strict=True))
