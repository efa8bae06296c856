"""usbldr.toml: which file is used, which keys are refused and how, and the assumptions of a run."""

import math
import re
import tomllib
import typing
from dataclasses import replace
from pathlib import Path

import pytest

from checkout import FIELD_CONFIGURATIONS, ROOT
from logs import refusal
from recordings import saved
from usbldr.filters.errors import UsageError
from usbldr.filters.models.noise import Contamination, Mixture, StudentT
from usbldr.filters.models.parameters import Parameters, ProcessNoise, SensorErrors, Start
from usbldr.io.axes import axis_signs
from usbldr.io.settings.configuration import find_configuration, parameters, parse_configuration
from usbldr.io.settings.sensor_sections import Configuration
from usbldr.io.settings.validation import read_document

FIELD = sorted(FIELD_CONFIGURATIONS.glob("*.toml"))


def parsed(tmp_path: Path, text: str) -> Configuration:
    file = saved(tmp_path / "usbldr.toml", text)
    return parse_configuration(read_document(file), file)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("[dvll]", "there is no section dvll; did you mean dvl? (allowed: schema, map, dvl, compass, usbl, gps, depth, "
         "truth, process, calibrate, start, file, layouts, part)"),
        ("[dvl]\nmountdeg = 1", "[dvl] has no key mountdeg; did you mean mount_deg? (allowed: topic, columns, "
         "device, axes, "
         "mount_deg, unit, level, scale_error, sound_speed_mps, assumed_sound_speed_mps, sd_mps, sd_scale, "
         "track, min_good_beams, lever_arm_m, time, latency_s, clock_step_s, noise)"),
        ("[dvl]\nmount_deg = 'x'", "[dvl] mount_deg: expected number, got text"),
        ("[dvl]\nlatency_s = nan", "[dvl] latency_s = nan is not a finite number"),
        ("[dvl]\nsd_mps = -1", "[dvl] sd_mps: expected number >= 1e-06"),
        ("[dvl]\naxes = 'FFD'", '[dvl]: axes = "FFD" is not three perpendicular directions; give one letter each '
         "for x, y and z: F or B, S (R) or P (L), U or D"),
        ("[dvl]\nlever_arm_m = [1, 2]", "[dvl] lever_arm_m: expected array of length 3, got 2"),
        ("[dvl]\nnoise = { kind = 'cauchy' }", "[dvl] noise: kind is missing or unknown (allowed: gaussian, mixture, "
         "student-t, contamination)"),
        ("[dvl]\nnoise = { kind = 'mixture', shar = 0.3 }", "[dvl.noise] has no key shar; did you mean share? "
         "(allowed: kind, share, variance_ratio, per)"),
        ("[compass]\nconvention = 'NWU'", "[compass] convention: NWU is not allowed (allowed: ENU, NED, compass)"),
        ("[usbl]\nsd_m = 'messages'", "[usbl] sd_m: messages is not allowed (allowed: a number, message)"),
        ("[usbl]\nframe = 'body'", "[usbl]: the head's position is missing (head = { lat_deg = ..., lon_deg = ..., "
         "depth_m = ... }, or on a ship { topic = ..., heading_topic = ... })"),
        ("[usbl]\nhead = { topic = '/ship', east_m = 1.0 }", "[usbl] head: state either the head's "
         "position or its topic"),
        ("[usbl]\nhead = { lat_deg = 1.0 }", "[usbl] head: state either lat_deg and lon_deg or east_m and north_m"),
        ("[usbl]\nrelative_to = 'head'", "[usbl]: the head's position is missing (head = { lat_deg = ..., lon_deg = "
         "..., depth_m = ... }, or on a ship { topic = ..., heading_topic = ... })"),
        ("[usbl]\nsd_m = 1.0\nbearing_sd_deg = 1.0", "[usbl]: sd_m cannot be combined with range_sd_m, range_sd_rel "
         "or bearing_sd_deg"),
        ("[map]\norigin_lat_deg = 1.0", "[map]: the key origin_lon_deg is missing"),
        ("[truth]\ncolumns = { time = 't' }", "[truth] columns: time is not allowed (allowed: time_ns, time_unix_us, "
         "time_unix_ms, time_unix_s, time_s, time_datenum, time_excel, time_julian, "
         "time_mjd, time_labview, time_ntp, time_filetime, time_ticks, x, y, lat_deg, lon_deg, sd_m)"),
        ("[truth]\ntopic = '/a'\nfile = 'b'", "[truth]: state either topic or file"),
        ("[truth]\ntopic = '/a'\ncolumns = { x = 'b' }", "[truth]: columns need file, not topic"),
        ("schema = 2", "schema: 2 is not allowed (allowed: 1)"),
    ],
)  # fmt: skip
def test_a_key_that_would_not_act_is_refused_by_name(tmp_path: Path, text: str, sentence: str) -> None:
    assert refusal(UsageError, parsed, tmp_path, text) == f"{tmp_path / 'usbldr.toml'}: {sentence}"


@pytest.mark.parametrize("file", FIELD, ids=lambda file: file.stem)
def test_the_field_configurations_are_accepted(file: Path) -> None:
    assert parse_configuration(read_document(file), file).truth.max_gap_s in (5.0, 30.0)


def test_letters_name_the_directions_of_x_y_and_z() -> None:
    assert axis_signs("FRD") == axis_signs("FSD") == ((1, 1), (0, 1), (2, -1))
    assert axis_signs("FLU") == axis_signs("FPU") == ((1, 1), (0, -1), (2, 1))
    assert axis_signs("SFU") == ((0, 1), (1, 1), (2, 1))
    assert axis_signs("UBL") == ((2, 1), (1, -1), (0, -1))


def test_the_named_configuration_beats_the_one_of_the_folder_or_within_the_log(tmp_path: Path) -> None:
    log = tmp_path / "dive7.mcap"
    log.touch()
    assert find_configuration(log, None) is None

    general, own, other = (tmp_path / n for n in ("usbldr.toml", "dive7.usbldr.toml", "other.toml"))
    for file, expected in ((general, general), (own, own), (other, own)):
        file.touch()
        assert find_configuration(log, None) == expected
    assert find_configuration(log, str(other)) == other
    assert find_configuration(log, "none") is None

    folder, inside = tmp_path / "dive7", tmp_path / "dive7" / "usbldr.toml"
    folder.mkdir()
    assert find_configuration(folder, None) == own
    inside.touch()
    assert find_configuration(folder, None) == inside


def test_without_keys_a_run_has_the_default_assumptions(tmp_path: Path) -> None:
    """And the sensor errors that are observable in the log are estimated."""
    assert parameters(parsed(tmp_path, "")) == Parameters(calibrate=("auto",))
    assert parameters(parsed(tmp_path, "[calibrate]\nstates = []")) == Parameters()


def test_every_key_of_the_model_reaches_the_assumptions(tmp_path: Path) -> None:
    found = parsed(
        tmp_path,
        """
        [dvl]
        lever_arm_m = [0.1, 0.2, 0.3]
        noise = { kind = "mixture", share = 0.2, variance_ratio = 25.0, per = "record" }
        [compass]
        noise = { kind = "contamination", share = 0.1, sd_deg = 18.0 }
        [usbl]
        lever_arm_m = [1, 2, 3]
        noise = { kind = "student-t", dof = 3.0, per = "scalar" }
        [gps]
        lever_arm_m = [0.4, -1, 1.5]
        noise = { kind = "contamination", share = 0.02, sd_m = 30.0 }
        [process]
        position_m = 0.1
        heading_deg = 1.8
        velocity_mps = 0.2
        turn_rate_dps = 3.6
        uncalibrated_m = 0.4
        [calibrate]
        states = ["latency", "scale"]
        scale_sd = 0.02
        mount_sd_deg = 1.8
        heading_sd_deg = 18.0
        heading_walk_deg = 3.6
        deviation_sd_deg = 9.0
        latency_sd_s = 0.7
        usbl_bias_sd_m = 0.6
        usbl_bias_time_s = 90.0
        [start]
        east_m = 1.0
        north_m = 2.0
        sd_m = 3.0
        """,
    )

    assert parameters(found) == replace(
        Parameters(),
        process=ProcessNoise(0.1, math.pi / 100, 0.2, math.pi / 50, 0.4),
        calibrate=("scale", "latency"),
        errors=SensorErrors(
            0.02, math.pi / 100, math.pi / 10, math.pi / 50, math.pi / 20, 0.7, usbl_bias_m=0.6, usbl_bias_s=90.0
        ),
        dvl=Mixture(0.2, 25.0, per_scalar=False),
        compass=Contamination(0.1, math.pi / 10, per_scalar=False),
        usbl=StudentT(3.0, per_scalar=True),
        dvl_lever_m=(0.1, 0.2, 0.3),
        usbl_lever_m=(1.0, 2.0, 3.0),
        gps=Contamination(0.02, 30.0),
        gps_lever_m=(0.4, -1.0, 1.5),
        start=Start(1.0, 2.0, 3.0),
    )


DOCUMENT = (ROOT / "docs" / "configuration.md").read_text(encoding="utf-8")


def sections() -> list[tuple[str, str]]:
    return [
        (name, key)
        for name, annotation in typing.get_type_hints(Configuration).items()
        for struct in (annotation, *typing.get_args(annotation))
        if hasattr(struct, "__struct_fields__")
        for key in struct.__struct_fields__
    ]


@pytest.mark.parametrize(("section", "key"), sections())
def test_every_key_is_explained_in_its_section_of_the_document(section: str, key: str) -> None:
    general, _, rest = DOCUMENT.replace("[[file]]", "[file]").partition("## Sections")
    own = rest.partition(f"### `[{section}]`")[2].partition("\n### ")[0]
    of_sensor = section not in ("map", "truth", "process", "calibrate", "start", "file")
    common = general.partition("Keys of every sensor")[2] if of_sensor else ""

    assert f"`{key}`" in own + common


def test_the_examples_and_the_noises_of_the_document_are_accepted() -> None:
    blocks = re.findall(r"```toml\n(.*?)```", DOCUMENT, flags=re.DOTALL)
    noises = [f"[usbl]\nnoise = {noise}" for noise in re.findall(r"`(\{ kind = .*?\})`", DOCUMENT)]

    assert blocks
    assert noises
    for text in (*blocks, *noises):
        parse_configuration(tomllib.loads(text), Path("example.toml"))
