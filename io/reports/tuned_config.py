"""The result of --tune, as text and as sections of a configuration."""

import json
from collections.abc import Mapping

from usbldr.filters.identification.identification import Identification, TunedParameter
from usbldr.filters.models.parameters import Parameters
from usbldr.io.settings.toml_text import noise_text, stated, toml_text

TUNED = "tuned.toml"  # in a run directory


def tuned_text(number: TunedParameter) -> str:
    """Return one number before and after, and one sigma down and up."""
    name = number.name.replace("_", " ")
    if not number.identified:
        return f"{name} {number.before:.3g} unchanged (hardly observable)"
    return f"{name} {number.before:.3g} to {number.after:.3g} ({number.low:.3g} to {number.high:.3g})"


def tuned_toml(log_name: str, found: Identification) -> str:
    """Return a configuration that states what was tuned, to be merged into that of the log."""
    title = [
        f"Noise that usbldr --tune estimated from {log_name} by the predictive likelihood, without the truth.",
        "To use it again, copy these keys into usbldr.toml. One sigma down and up is in brackets.",
        *(tuned_text(number) for number in found.tuned),
    ]
    return toml_text(title, _sections(found.parameters), {})


def _sections(found: Parameters) -> Mapping[str, Mapping[str, str]]:
    process, sizes = stated(found.process), stated(found.errors)
    keys = {"latency": ("latency_sd_s",), "usbl-bias": ("usbl_bias_sd_m", "usbl_bias_time_s")}
    return {
        "dvl": {"sd_scale": repr(found.dvl_sd_scale)},
        "usbl": {"sd_scale": repr(found.usbl_sd_scale), "noise": noise_text(found.usbl, "usbl")},
        "process": {"velocity_mps": process["velocity_mps"]},
        "calibrate": {"states": json.dumps(found.calibrate)}
        | {key: sizes[key] for error, names in keys.items() if error in found.calibrate for key in names},
    }
