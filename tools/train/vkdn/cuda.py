"""What only a CUDA device has: streams, a step as one graph, TF32. On a CPU everything here does nothing."""
import torch


class Ahead:
    """Makes the next step's inputs on a stream of its own while this step computes."""

    def __init__(self, device):
        self.stream = torch.cuda.Stream() if device.type == "cuda" else None

    def run(self, make):
        if self.stream is None:
            return make()
        self.stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(self.stream):
            return make()

    def join(self):
        if self.stream is not None:
            torch.cuda.current_stream().wait_stream(self.stream)


def capture(step):
    """Runs the step three times and captures it. -> a graph, or None where that cannot be"""
    side = torch.cuda.Stream()
    side.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(side):
        for _ in range(3):
            step()
    torch.cuda.current_stream().wait_stream(side)
    torch.cuda.synchronize()
    graph = torch.cuda.CUDAGraph()
    try:
        with torch.cuda.graph(graph):
            step()
        graph.replay()
        torch.cuda.synchronize()
        return graph
    except RuntimeError as error:
        print("no graph:", repr(error)[:2000], flush=True)
        torch.cuda.synchronize()
        return None


class Pace:
    """Lets the host run three steps ahead at most, or time would be up long before the work is."""

    def __init__(self, device):
        self.events = [torch.cuda.Event() for _ in range(4)] if device.type == "cuda" else []

    def stepped(self, steps):
        """After the step that makes it `steps` since the start."""
        if self.events:
            self.events[steps % 4].record()
            if steps >= 4:
                self.events[(steps + 1) % 4].synchronize()


def precise(yes):
    """Evaluations in full float32; training may use TF32, its operands come from bfloat16."""
    torch.backends.cudnn.benchmark, torch.backends.cudnn.benchmark_limit = not yes, 6
    torch.backends.cudnn.allow_tf32 = not yes
    torch.backends.cuda.matmul.allow_tf32 = not yes
