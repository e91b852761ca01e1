"""One network's training on crops in device memory: batch, forward, backward, optimizers and average as one step without
synchronisation, captured as a CUDA graph where there is CUDA. The schedule goes by time."""
import copy
import math
import time
from dataclasses import dataclass, field

import torch

from .blocks import FilmCnn
from .crops import Batches, Changes
from .flat import Layout, Optimizer
from .losses import balanced, relative_l2
from .model import Denoiser


@dataclass
class Options:
    batch: int = 32
    rate: float = 1e-3  # peak; a cosine over the time leads to `floor`
    floor: float = 1e-6
    warm_up: int = 100  # steps
    head_gain: float = 2.0  # of the head's rate over the rest's
    average_decay: float = 0.998
    delta: float = 0.5  # see losses.py
    bright: float = 1.0
    knee: float = 0.002
    film_jitter: float = 0.3
    precision: torch.dtype = torch.bfloat16
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
        for module in self.network.modules():
            if isinstance(module, FilmCnn):
                module.mean_jitter = options.film_jitter
        table = dict(self.network.named_parameters())
        self.parameters = [table[name] for name in layout.names]
        self.gradients = layout.views(self.gradient)
        gains = layout.vector(lambda name: options.head_gain if name.startswith("head.") else 1)
        self.optimizer = Optimizer(layout, self.weights, self.gradient, gains)
        self.batches = Batches(store, options.batch, options.changes)
        self.inputs = self.batches.batch()
        self.beside = torch.cuda.Stream() if self.device.type == "cuda" else None
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

    def next_batch(self):
        """The next step's inputs, made on a stream of its own while this step computes."""
        if self.beside is None:
            return self.batches.batch()
        self.beside.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(self.beside):
            return self.batches.batch()

    def take(self, following):
        if self.beside is not None:
            torch.cuda.current_stream().wait_stream(self.beside)
        for ours, new in zip(self.inputs, following):
            ours.copy_(new)

    def step(self):
        options = self.options
        if self.working is not self.weights:
            self.working.copy_(self.weights)
        following = self.next_batch()
        c, aux, target = self.inputs
        errors = relative_l2(self.network(c, aux), target, options.delta, options.bright)
        loss = balanced(errors, options.knee)
        gradients = torch.autograd.grad(loss, self.parameters, allow_unused=True)
        with torch.no_grad():
            # A head without gate leaves the gate's and the residual's own weights without gradient or with zeros.
            pairs = [(ours, g) for ours, g in zip(self.gradients, gradients) if g is not None]
            torch._foreach_copy_([ours for ours, _ in pairs], [g for _, g in pairs])
            norm = self.optimizer.step()
            self.averaged.lerp_(self.weights, 1 - self.keep)
            self.take(following)
            self.sums.add_(torch.stack([loss.detach(), errors.detach().mean(), norm, torch.ones_like(norm)]))

    def capture(self):
        """Warms up with a rate of 0 and captures the step; the weights stay. -> whether there is a graph now"""
        self.optimizer.rate.fill_(0.0)
        self.keep.fill_(1.0)
        side = torch.cuda.Stream()
        side.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(side):
            for _ in range(3):
                self.step()
        torch.cuda.current_stream().wait_stream(side)
        torch.cuda.synchronize()
        graph = torch.cuda.CUDAGraph()
        try:
            with torch.cuda.graph(graph):
                self.step()
            graph.replay()
            torch.cuda.synchronize()
            self.graph = graph
        except RuntimeError as error:
            print("no graph:", repr(error)[:2000], flush=True)
            torch.cuda.synchronize()
        for t in [*self.optimizer.state(), self.sums]:
            t.zero_()
        return self.graph is not None

    def rate(self, progress):
        o = self.options
        cosine = o.floor + (o.rate - o.floor) * 0.5 * (1 + math.cos(math.pi * min(progress, 1.0)))
        return cosine * min(1.0, (self.steps + 1) / o.warm_up)

    def run(self, seconds, every, report, most_steps=math.inf):
        """Steps for `seconds`, or `most_steps`; report(facts) about every `every` seconds and at the end."""
        start = reported = time.time()
        events = [torch.cuda.Event() for _ in range(4)] if self.device.type == "cuda" else []
        reporting = 0.0
        while (progress := max((time.time() - start) / seconds, self.steps / most_steps)) < 1:
            self.optimizer.rate.fill_(self.rate(progress))
            self.keep.fill_(min(self.options.average_decay, (1 + self.steps) / (10 + self.steps)))
            self.graph.replay() if self.graph else self.step()
            self.steps += 1
            if events:
                # The host runs three steps ahead at most, or time would be up long before the work is.
                events[self.steps % 4].record()
                if self.steps >= 4:
                    events[(self.steps + 1) % 4].synchronize()
            if time.time() - reported > every:
                before = time.time()
                report(self.facts(before - start - reporting, progress))
                reported = time.time()
                reporting += reported - before
        report(self.facts(time.time() - start - reporting, 1.0) | {"final": True})

    def facts(self, seconds, progress):
        """What happened since the last call; waits for the device."""
        *sums, count = self.sums.tolist()
        self.sums.zero_()
        if count:
            self.means = [total / count for total in sums]
        loss, error, norm = self.means
        return {
            "step": self.steps,
            "seconds": round(seconds, 1),
            "steps_per_s": round(self.steps / max(seconds, 1e-3), 2),
            "loss": round(loss, 6),
            "error": round(error, 6),
            "gradient": round(norm, 4),
            "rate": self.rate(progress),
        }

    def averaged_model(self):
        """A Denoiser of its own with the averaged weights, on the CPU."""
        model = Denoiser(self.average.arch)
        model.load_state_dict({name: t.cpu() for name, t in self.average.state_dict().items()})
        return model.eval()
