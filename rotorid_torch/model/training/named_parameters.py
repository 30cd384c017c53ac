"""The parameter vector as named tensors that torch's optimisers take: views of its storage, gradients too."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from torch import Tensor, nn


@dataclass(frozen=True)
class NamedPart:
    """Some successive numbers of the vector as one tensor."""

    name: str
    first: int
    shape: tuple[int, ...]
    count: int

    def of(self, vector: Tensor) -> Tensor:
        """The view of a vector [P]."""
        return vector[self.first : self.first + self.count].view(self.shape)


@dataclass(eq=False)
class NamedParameters:
    """Leaves that share their numbers with a vector; what torch accumulates for the vector appears in theirs.

    A leaf whose gradient was set to None starts from zero again, and so does one whose gradient was set to zero.
    """

    vector: nn.Parameter
    pieces: Sequence[NamedPart]
    leaves: list[nn.Parameter] = field(init=False)

    def __post_init__(self) -> None:
        self.leaves = [nn.Parameter(piece.of(self.vector.detach())) for piece in self.pieces]
        self.vector.register_hook(self._before)
        self.vector.register_post_accumulate_grad_hook(self._after)

    def __iter__(self) -> Iterator[tuple[str, nn.Parameter]]:
        return iter([(piece.name, leaf) for piece, leaf in zip(self.pieces, self.leaves, strict=True)])

    def follow(self) -> None:
        """Share numbers and gradients of a vector that was moved to another device or type, in the same leaves."""
        for piece, leaf in zip(self.pieces, self.leaves, strict=True):
            gradient = None if leaf.grad is None or self.vector.grad is None else piece.of(self.vector.grad)
            leaf.grad = None  # torch refuses numbers of another type beside it
            leaf.data, leaf.grad = piece.of(self.vector.detach()), gradient

    def belong_to(self, vector: Any) -> bool:
        """Whether this is still the vector, in its place."""
        return vector is self.vector and vector.data_ptr() == self.leaves[0].data_ptr()

    def _before(self, gradient: Tensor) -> None:
        """What has been let go of is not accumulated upon."""
        if self.vector.grad is None:
            return
        for piece, leaf in zip(self.pieces, self.leaves, strict=True):
            if leaf.grad is None:
                piece.of(self.vector.grad).zero_()

    def _after(self, vector: Tensor) -> None:
        assert vector.grad is not None
        for piece, leaf in zip(self.pieces, self.leaves, strict=True):
            if leaf.requires_grad:
                leaf.grad = piece.of(vector.grad)
