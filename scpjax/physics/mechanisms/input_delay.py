"""Dead time between the recorded drive and the actuator."""

from jaxtyping import Array

from scpjax.parameter import Parameter
from scpjax.physics.mechanism import Mechanism, Values


class InputDelay(Mechanism):
    name = "input_delay"
    title = "Dead time"
    subsystem = "drive"
    equation = "u(t) = recorded(t - tau)"
    source = "transport or communication delay: Astrom, Hagglund, Advanced PID Control, ch. 2"
    says = "The drive reaches the actuator later than the recording says."
    excited_by = "voltage steps"
    parameters = (
        Parameter(
            name="time",
            symbol="τ",
            unit="s",
            description="dead time",
            typical=0.1,
            bounds=(0.002, 3.0),
            null=0.0,
            spread=2.0,
            time="response",
        ),
    )
    starts = ((0.03,), (0.2,))

    def delay(self, p: Values) -> Array:
        return p.time
