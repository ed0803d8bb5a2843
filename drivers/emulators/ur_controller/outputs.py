"""Digital outputs of a controller: clients set them, and something may be wired to them."""

from __future__ import annotations

from collections.abc import Callable

Values = tuple[float, ...]
_BITS, _MASK, _LEVELS = "actual_digital_output_bits", "standard_digital_output_mask", "standard_digital_output"


class DigitalOutputs:
    """Outputs with wired callbacks: number -> function that is called on a rising edge."""

    def __init__(self) -> None:
        self.wired: dict[int, Callable[[], None]] = {}

    def cycle(self, values: dict[str, Values]) -> None:
        """Set the outputs to the values that clients wrote since the last control cycle."""
        mask = int(values[_MASK][0])
        if not mask:
            return
        before = int(values[_BITS][0])
        now = (before & ~mask) | (int(values[_LEVELS][0]) & mask)
        values[_BITS], values[_MASK] = (now,), (0,)
        for number, rises in self.wired.items():
            if (now & ~before) >> number & 1:
                rises()
