"""How far a training is, and its rate."""
import math
import time
from datetime import datetime


def deadline_of(text):
    """A local time in ISO format, or seconds since the epoch -> seconds since the epoch."""
    try:
        return float(text)
    except ValueError:
        return datetime.fromisoformat(text).timestamp()


class Schedule:
    """Ends after `steps` where given, else at `deadline` (seconds since the epoch) where given, else after `hours` in
    all, of which `before` seconds were spent by earlier runs of the same training."""

    def __init__(self, peak, warm_up, floor=1e-6, hours=None, deadline=None, steps=None, before=0.0):
        self.peak, self.warm_up, self.floor, self.steps = peak, warm_up, floor, steps
        self.before, self.start = before, time.time()
        self.end = deadline if deadline else self.start + (hours or math.inf) * 3600 - before

    def seconds(self):
        """Spent in all."""
        return self.before + time.time() - self.start

    def progress(self, step):
        """0 at the start, 1 at the end."""
        if self.steps:
            return min(1.0, step / self.steps)
        left = self.end - time.time()
        return min(1.0, self.seconds() / (self.seconds() + left)) if left > 0 else 1.0

    def rate(self, step):
        """Linear warm-up by steps, times a cosine from `peak` to `floor`."""
        cosine = self.floor + (self.peak - self.floor) * 0.5 * (1 + math.cos(math.pi * self.progress(step)))
        return cosine * min(1.0, (step + 1) / self.warm_up)
