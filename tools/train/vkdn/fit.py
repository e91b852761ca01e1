"""One network's training on crops in the device's memory: batch, forward, backward, optimizers and average as one step.

On a GPU nothing in it waits for the host, so that it can be captured as one graph; on a CPU threads take shares of a
batch.
"""
import copy
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import torch

from . import cuda
from .blocks import FilmCnn
from .crops import Batches, Changes
from .flat import Layout, Optimizer
from .locality import far_moves
from .losses import balanced, energy, relative_l2
from .model import Denoiser


@dataclass
class Options:
    """What a step depends on but for its rate; `vkdn.train --help` says what each is."""

    batch: int = 32
    beta2: float = 0.99
    clip: float = 1.0
    head_gain: float = 2.0
    average_decay: float = 0.998
    delta: float = 0.5
    bright: float = 1.0
    knee: float = 0.002
    energy: float = 5.0
    clean_weight: float = 4.0
    locality: float = 0.0
    film_jitter: float = 0.3
    precision: torch.dtype = torch.bfloat16
    parallel: int = 1
    share: int | None = None
    threads: int | None = None
    changes: Changes = field(default_factory=Changes)


class Fit:
    """model: a Denoiser with the weights to start from. `average` is the network with the averaged weights, float32."""

    def __init__(self, model, store, options):
        self.options, self.device = options, store.device
        self.layout = layout = Layout(model.to(self.device))
        zeros = lambda kind=torch.float32: torch.zeros(layout.total, dtype=kind, device=self.device)
        self.weights, self.gradient = zeros(), zeros()
        for piece, p in zip(layout.views(self.weights), layout.parameters):
            piece.copy_(p.detach())
        self.averaged = self.weights.clone()
        low = options.precision != torch.float32
        self.working = zeros(options.precision) if low else self.weights
        self.network = self.network_of(model, self.working, self.weights).train()
        self.average = self.network_of(model, self.averaged, self.averaged).eval().requires_grad_(False)
        # What a pixel moves far away is smaller than the roundings of bfloat16.
        self.exact = self.network_of(model, self.weights, self.weights).eval() if options.locality else None
        for module in self.network.modules():
            if isinstance(module, FilmCnn):
                module.mean_jitter = options.film_jitter
        self.parameters = self.in_order(self.network) + (self.in_order(self.exact) if self.exact else [])
        self.gradients = layout.views(self.gradient)
        gains = layout.vector(lambda name: options.head_gain if name.startswith("head.") else 1)
        self.optimizer = Optimizer(layout, self.weights, self.gradient, gains, options.beta2, options.clip)
        self.batches = Batches(store, options.batch, options.changes)
        self.inputs = self.batches.batch()
        self.ahead = cuda.Ahead(self.device)
        self.pool = self.threads()
        self.keep = torch.zeros((), device=self.device)
        self.sums = torch.zeros(4, device=self.device)  # loss, error, gradient norm, steps
        self.means = [0.0, 0.0, 0.0]
        self.graph, self.steps = None, 0

    def network_of(self, model, flat, exact):
        """A network whose parameters are pieces of `flat`; bias tables, which enter scores in float32, of `exact`."""
        network = copy.deepcopy(model)
        table = dict(network.named_parameters())
        for name, piece, wide in zip(self.layout.names, self.layout.views(flat), self.layout.views(exact)):
            table[name].data = wide if name.endswith("bias_table") else piece
        return network

    def in_order(self, network):
        """Its parameters as the flat weights have them."""
        table = dict(network.named_parameters())
        return [table[name] for name in self.layout.names]

    def threads(self):
        o = self.options
        if self.device.type != "cpu" or not o.share or o.share >= o.batch:
            return None
        start = (lambda: torch.set_num_threads(o.threads)) if o.threads else None
        return ThreadPoolExecutor(o.parallel, initializer=start)

    def gradients_of(self, share):
        """Loss, error and gradients of a part of a batch, each weighted by its size; None where nothing asks for a
        parameter."""
        c, aux, target, clean = share
        o = self.options
        prediction = self.network(c, aux)
        errors = relative_l2(prediction, target, o.delta, o.bright)
        both = errors + o.energy * energy(prediction, target) if o.energy else errors
        loss = balanced(both * (1 + (o.clean_weight - 1) * clean), o.knee)
        if self.exact:
            loss = loss + o.locality * far_moves(self.exact, c[:1], aux[:1])
        weight = len(c) / o.batch
        gradients = torch.autograd.grad(loss * weight, self.parameters, allow_unused=True)
        return loss.detach() * weight, errors.detach().mean() * weight, gradients

    def gradients_of_batch(self):
        """On a CPU each thread takes a share when it is free. Where others use the cores too, this loses far less than
        parallel loops inside every operation, which wait for the slowest core a thousand times a step."""
        if self.pool is None:
            return self.gradients_of(self.inputs)
        shares = zip(*(t.split(self.options.share) for t in self.inputs))
        losses, errors, gradients = zip(*self.pool.map(self.gradients_of, shares))
        return sum(losses), sum(errors), [total(parts) for parts in zip(*gradients)]

    def step(self):
        if self.working is not self.weights:
            self.working.copy_(self.weights)
        following = self.ahead.run(self.batches.batch)
        loss, error, gradients = self.gradients_of_batch()
        with torch.no_grad():
            # A head without gate leaves the gate's and the residual's own weights without gradient or with zeros.
            count = len(self.gradients)
            pairs = [(ours, g) for ours, g in zip(self.gradients, gradients[:count]) if g is not None]
            torch._foreach_copy_([ours for ours, _ in pairs], [g for _, g in pairs])
            for ours, g in zip(self.gradients, gradients[count:]):
                if g is not None:
                    ours.add_(g)
            norm = self.optimizer.step()
            self.averaged.lerp_(self.weights, 1 - self.keep)
            self.ahead.join()
            for ours, new in zip(self.inputs, following):
                ours.copy_(new)
            self.sums.add_(torch.stack([loss, error, norm, torch.ones_like(norm)]))

    def capture(self):
        """Captures the step at a rate of 0: the weights stay. -> whether there is a graph now"""
        self.optimizer.rate.fill_(0.0)
        self.keep.fill_(1.0)
        self.graph = cuda.capture(self.step)
        for t in [*self.optimizer.state(), self.sums]:
            t.zero_()
        return self.graph is not None

    def run(self, schedule, every, report, stopped=lambda: False):
        """Steps to the schedule's end or until `stopped()`; report(facts) about every `every` seconds and at the
        end."""
        pace = cuda.Pace(self.device)
        first, began = self.steps, schedule.seconds()
        reported, reporting = began, 0.0
        while schedule.progress(self.steps) < 1 and not stopped():
            self.optimizer.rate.fill_(schedule.rate(self.steps))
            self.keep.fill_(min(self.options.average_decay, (1 + self.steps) / (10 + self.steps)))
            self.graph.replay() if self.graph else self.step()
            self.steps += 1
            pace.stepped(self.steps - first)
            if schedule.seconds() - reported > every:
                before = schedule.seconds()
                report(self.facts(schedule, (self.steps - first) / max(before - began - reporting, 1e-3)))
                reported = schedule.seconds()
                reporting += reported - before
        spent = schedule.seconds() - began - reporting
        report(self.facts(schedule, (self.steps - first) / max(spent, 1e-3)))

    def facts(self, schedule, speed):
        """What happened since the last call; waits for the device."""
        *sums, count = self.sums.tolist()
        self.sums.zero_()
        if count:
            self.means = [total / count for total in sums]
        loss, error, norm = self.means
        return {
            "step": self.steps,
            "seconds": round(schedule.seconds(), 1),
            "steps_per_s": round(speed, 2),
            "loss": round(loss, 6),
            "error": round(error, 6),
            "gradient": round(norm, 4),
            "rate": schedule.rate(self.steps),
        }

    def averaged_model(self):
        """A Denoiser of its own with the averaged weights, on the CPU."""
        model = Denoiser(self.average.arch)
        model.load_state_dict({name: t.cpu() for name, t in self.average.state_dict().items()})
        return model.eval()

    def state(self):
        """What going on needs beside the averaged weights, on the CPU."""
        copied = lambda t: t.detach().to("cpu", copy=True)
        optimizer = [copied(t) for t in self.optimizer.state()]
        weights = copied(self.weights)
        return {"names": self.layout.names, "weights": weights, "optimizer": optimizer, "steps": self.steps}

    def restore(self, state, average):
        """`state()` of an earlier run and its averaged weights {name: tensor}; a graph stays good."""
        if state["names"] != self.layout.names:
            raise ValueError("the checkpoint is of another architecture")
        self.weights.copy_(state["weights"])
        for ours, theirs in zip(self.optimizer.state(), state["optimizer"], strict=True):
            ours.copy_(theirs)
        self.average.load_state_dict(average)
        self.steps = state["steps"]


def total(parts):
    """The sum, in float32, of one parameter's gradients by several threads."""
    return None if parts[0] is None else sum(part.float() for part in parts)
