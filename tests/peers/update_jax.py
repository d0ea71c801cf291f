"""DDPG updates by JAX: one jitted function that draws the minibatch and changes everything, its buffers donated."""

import argparse
from functools import partial

import bench
import ddpg_work
import jax
import numpy as np
from jax import numpy as jnp

FIRST, SECOND, EPSILON = 0.9, 0.999, 1e-8


def network(rng, inputs, outputs):
    """Weights and biases, uniform as PyTorch's."""
    return [
        (jnp.asarray(rng.uniform(-1, 1, pair) / np.sqrt(pair[0]), jnp.float32),
         jnp.asarray(rng.uniform(-1, 1, pair[1]) / np.sqrt(pair[0]), jnp.float32))
        for pair in ddpg_work.widths(inputs, outputs)
    ]  # fmt: skip


def forward(layers, x):
    for weights, biases in layers[:-1]:
        x = jax.nn.relu(x @ weights + biases)
    return x @ layers[-1][0] + layers[-1][1]


def act(layers, s):
    return jnp.tanh(forward(layers, s))


def value(layers, s, a):
    return forward(layers, jnp.concatenate([s, a], 1))


def adam(layers, gradient, moments, rate, count):
    """One step of Adam."""
    first = jax.tree.map(lambda m, g: FIRST * m + (1 - FIRST) * g, moments[0], gradient)
    second = jax.tree.map(lambda v, g: SECOND * v + (1 - SECOND) * g * g, moments[1], gradient)
    step = rate * jnp.sqrt(1 - SECOND**count) / (1 - FIRST**count)
    layers = jax.tree.map(lambda w, m, v: w - step * m / (jnp.sqrt(v) + EPSILON), layers, first, second)
    return layers, (first, second)


@partial(jax.jit, static_argnames="size", donate_argnums=0)
def update(state, replay, size):
    """The next state: actor, critic, their targets, Adam's moments, dice and count."""
    actor, critic, actor_target, critic_target, actor_moments, critic_moments, key, count = state
    key, dice = jax.random.split(key)
    rows = jax.random.randint(dice, (size,), 0, ddpg_work.TRANSITIONS)
    s, a, r, discount, following = (column[rows] for column in replay)
    y = r + discount * value(critic_target, following, act(actor_target, following))
    critic_gradient = jax.grad(lambda layers: jnp.mean((value(layers, s, a) - y) ** 2))(critic)
    count = count + 1
    critic, critic_moments = adam(critic, critic_gradient, critic_moments, ddpg_work.CRITIC_RATE, count)
    actor_gradient = jax.grad(lambda layers: -jnp.mean(value(critic, s, act(layers, s))))(actor)
    actor, actor_moments = adam(actor, actor_gradient, actor_moments, ddpg_work.ACTOR_RATE, count)

    def average(target, source):
        return jax.tree.map(lambda t, w: t + ddpg_work.TARGET_RATE * (w - t), target, source)

    targets = average(actor_target, actor), average(critic_target, critic)
    return actor, critic, *targets, actor_moments, critic_moments, key, count


def begin():
    """A fresh state; every array its own, as donation wants it."""
    rng = np.random.default_rng(1)
    actor = network(rng, ddpg_work.OBSERVATION, ddpg_work.ACTION)
    critic = network(rng, ddpg_work.OBSERVATION + ddpg_work.ACTION, 1)

    def copy(tree, factor=1.0):
        return jax.tree.map(lambda x: jnp.array(x * factor), tree)

    moments = [(copy(net, 0.0), copy(net, 0.0)) for net in (actor, critic)]
    return actor, critic, copy(actor), copy(critic), *moments, jax.random.key(1), jnp.float32(0)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("batch", type=int)
    batch = parser.parse_args().batch
    replay = [jnp.asarray(column) for column in ddpg_work.replay()]
    state = [begin()]

    def work():
        state[0] = jax.block_until_ready(update(state[0], replay, batch))

    for _ in range(20):
        work()
    bench.serve(work, name="JAX jit", how=bench.version("jax"))


if __name__ == "__main__":
    main()
