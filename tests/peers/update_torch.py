"""DDPG updates by PyTorch: `eager` as textbooks write it, `tuned` by hand, `compiled` by torch.compile besides.

With `--device cuda` on a GPU, replay memory included; with `--graphs` an update is captured once as a CUDA graph.
"""

import argparse
import contextlib
import copy

import bench
import ddpg_work
import torch
from torch import nn
from torch.nn import functional


def network(inputs, outputs, last):
    """Layers with ReLU between them."""
    layers = []
    for width, following in ddpg_work.widths(inputs, outputs):
        layers += [nn.Linear(width, following), nn.ReLU()]
    return nn.Sequential(*layers[:-1], last)


class Learner:
    """Both networks, their targets, the replay memory."""

    def __init__(self, batch, device="cpu"):
        torch.manual_seed(1)
        self.batch, self.device = batch, device
        self.actor = network(ddpg_work.OBSERVATION, ddpg_work.ACTION, nn.Tanh()).to(device)
        self.critic = network(ddpg_work.OBSERVATION + ddpg_work.ACTION, 1, nn.Identity()).to(device)
        self.actor_target, self.critic_target = copy.deepcopy(self.actor), copy.deepcopy(self.critic)
        self.replay = [torch.from_numpy(column).to(device) for column in ddpg_work.replay()]
        self.optimizers()

    def optimizers(self):
        self.actor_adam = torch.optim.Adam(self.actor.parameters(), ddpg_work.ACTOR_RATE)
        self.critic_adam = torch.optim.Adam(self.critic.parameters(), ddpg_work.CRITIC_RATE)

    def minibatch(self):
        rows = torch.randint(ddpg_work.TRANSITIONS, (self.batch,), device=self.device)
        return [column[rows] for column in self.replay]

    def critic_loss(self, s, a, r, discount, following):
        with torch.no_grad():
            own = self.actor_target(following)
            y = r + discount * self.critic_target(torch.cat([following, own], 1))
        return functional.mse_loss(self.critic(torch.cat([s, a], 1)), y)

    def actor_loss(self, s):
        return -self.critic(torch.cat([s, self.actor(s)], 1)).mean()

    def update(self):
        """As in the textbook."""
        batch = self.minibatch()
        loss = self.critic_loss(*batch)
        self.critic_adam.zero_grad()
        loss.backward()
        self.critic_adam.step()
        loss = self.actor_loss(batch[0])
        self.actor_adam.zero_grad()
        loss.backward()
        self.actor_adam.step()
        with torch.no_grad():
            for target, source in ((self.actor_target, self.actor), (self.critic_target, self.critic)):
                for theirs, ours in zip(target.parameters(), source.parameters(), strict=True):
                    theirs.mul_(1 - ddpg_work.TARGET_RATE).add_(ours, alpha=ddpg_work.TARGET_RATE)


class Tuned(Learner):
    """Fused Adam, one call for all of a target's averaging, one gather a minibatch, no gradient that nobody uses."""

    def __init__(self, batch, device="cpu"):
        super().__init__(batch, device)
        self.rows = torch.cat(self.replay, 1)
        lengths = [column.shape[1] for column in self.replay]
        self.lengths = lengths
        self.targets = [*self.actor_target.parameters(), *self.critic_target.parameters()]
        self.sources = [*self.actor.parameters(), *self.critic.parameters()]
        self.critics, self.actors = list(self.critic.parameters()), list(self.actor.parameters())

    def optimizers(self):
        groups = [
            {"params": list(self.actor.parameters()), "lr": ddpg_work.ACTOR_RATE},
            {"params": list(self.critic.parameters()), "lr": ddpg_work.CRITIC_RATE},
        ]
        # A graph cannot look at a count of steps that stands on the host.
        self.adam = torch.optim.Adam(groups, fused=True, capturable=self.device == "cuda")

    def minibatch(self):
        rows = torch.randint(ddpg_work.TRANSITIONS, (self.batch,), device=self.device)
        return self.rows.index_select(0, rows).split(self.lengths, 1)

    def update(self):
        batch = self.minibatch()
        gradients = torch.autograd.grad(self.critic_loss(*batch), self.critics)
        gradients = torch.autograd.grad(self.actor_loss(batch[0]), self.actors) + gradients
        for parameter, gradient in zip(self.sources, gradients, strict=True):
            parameter.grad = gradient
        self.adam.step()
        with torch.no_grad():
            torch._foreach_lerp_(self.targets, self.sources, ddpg_work.TARGET_RATE)


class Compiled(Tuned):
    """Losses, their gradients and the averaging compiled by inductor for this processor."""

    def __init__(self, batch, device="cpu"):
        super().__init__(batch, device)
        self.critic_loss = torch.compile(self.critic_loss, mode="max-autotune-no-cudagraphs", dynamic=False)
        self.actor_loss = torch.compile(self.actor_loss, mode="max-autotune-no-cudagraphs", dynamic=False)


VARIANTS = {"eager": Learner, "tuned": Tuned, "compiled": Compiled}


def captured(update):
    """`update` as a CUDA graph that was captured once."""
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        update()
    return graph.replay


def queued(update, together):
    """So many updates one behind the other, then one wait for the GPU."""

    def work():
        for _ in range(together):
            update()
        torch.cuda.synchronize()

    return work


def warm_up(update, on_gpu):
    """Twenty updates; before a capture they have to run beside the stream that everything runs on."""
    stream = torch.cuda.stream(torch.cuda.Stream()) if on_gpu else contextlib.nullcontext()
    with stream:
        for _ in range(20):
            update()
    if on_gpu:
        torch.cuda.synchronize()


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("variant", choices=VARIANTS)
    parser.add_argument("batch", type=int)
    parser.add_argument("--device", choices=["cpu", "cuda"], default="cpu")
    parser.add_argument("--graphs", action="store_true", help="capture an update as a CUDA graph")
    parser.add_argument("--together", type=int, default=1, help="updates that go to the GPU without a wait")
    options = parser.parse_args()
    on_gpu = options.device == "cuda"
    if on_gpu and not torch.cuda.is_available():
        bench.refuse("PyTorch finds no GPU: torch.cuda.is_available() is False")
    if options.graphs and (not on_gpu or options.variant == "eager"):
        parser.error("--graphs is for --device cuda and a variant that steps on the GPU: tuned, compiled")
    torch.set_num_threads(1)
    learner = VARIANTS[options.variant](options.batch, options.device)
    warm_up(learner.update, on_gpu)
    work = captured(learner.update) if options.graphs else learner.update
    work = queued(work, options.together) if on_gpu else work
    how = f"{bench.version('torch')}, {torch.cuda.get_device_name()}" if on_gpu else bench.version("torch")
    bench.serve(work, name=f"PyTorch {options.variant}", how=how)


if __name__ == "__main__":
    main()
