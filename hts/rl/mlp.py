"""Small networks on a CPU, forward and backward written out.

Products of a few hundred samples are fast; what lies between them is not, once it goes through autograd: new memory for
every result, a slow ELU, passes over memory for biases and their gradients. Here every result has its place, ELU takes
e^min(z, 0), which is also its derivative, and a bias is a column of its weight that meets a row of ones.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor


class Workspace:
    """Where networks that run one after the other put what lies between their layers, B samples in columns."""

    def __init__(self, widths: Sequence[int], samples: int, like: Tensor) -> None:
        """widths: of the hidden layers; like: of what type and device."""
        widest = like.new_empty(max(widths, default=0) * samples)
        self.before = [widest[: width * samples].view(width, samples) for width in widths]  # one place for all
        self.slopes = [like.new_empty(width, samples) for width in widths]
        self.after = [like.new_ones(width + 1, samples) for width in widths]


class MLP:
    """Linear layers with ELU between them, samples in columns: x [inputs + 1, B], the last row ones -> y [outputs, B].

    layers: [outputs, inputs + 1], the last column the bias; gradients: of the same shapes, overwritten by `backward`.
    """

    def __init__(self, layers: Sequence[Tensor], gradients: Sequence[Tensor]) -> None:
        self.layers, self.gradients = list(layers), list(gradients)

    def forward(self, x: Tensor, space: Workspace) -> Tensor:
        """x [inputs + 1, B] -> y [outputs, B]. What `backward` wants to know stays in space."""
        for weight, z, slope, after in zip(self.layers, space.before, space.slopes, space.after, strict=False):
            h = after[:-1]  # below it the ones
            torch.mm(weight, x, out=z)
            torch.clamp(z, max=0.0, out=slope).exp_()  # ELU'(z) = e^min(z, 0)
            torch.maximum(z, torch.sub(slope, 1.0, out=h), out=h)  # ELU(z) = max(z, ELU'(z) - 1)
            x = after
        return torch.mm(self.layers[-1], x)

    def backward(self, x: Tensor, d: Tensor, space: Workspace) -> None:
        """Gradients of sum(d * y), d [outputs, B], after `forward` with the same x and space,
        which is used up by it."""
        inputs = [x, *space.after]
        for index in reversed(range(len(self.layers))):
            torch.mm(d, inputs[index].t(), out=self.gradients[index])  # dL/dW = d h^T
            if index:  # dL/dz = W^T d * ELU'(z), where h was: nobody asks for it again
                h = inputs[index][:-1]
                d = torch.mm(self.layers[index][:, :-1].t(), d, out=h).mul_(space.slopes[index - 1])
