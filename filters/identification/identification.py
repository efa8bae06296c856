"""What a log itself says of a run: the parameters to run with, and the reasons for them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from usbldr.filters.models.parameters import NOT_SMOOTHED, Parameters, SensorChange

LEVER_OR_LATENCY = frozenset(("dvl-lever", "latency"))  # keys of usbl_likelihood.KEYS
HEADING_OR_DEVIATION = frozenset(("heading", "deviation"))
UNUSUAL = 2.0  # [-] of the prior sigma: an error beyond it is said to be more than is usual
DR_WALK_NAME = "position_walk_m"  # fixed: the name under which a change of ProcessNoise.position_m is reported
STRONG_ODDS = 20.0  # [-] from which on evidence is strong: Kass and Raftery, see evidence.py
MOST_OF_SCALE = 1.5  # [-] by judgement: sound speed and angles of beams change speeds by per cents
OUTLIERS = 3  # [fixes] the most in a row that 5 to 10 % of outliers among a thousand fixes are by chance
EARLY_SIGMAS = 3.0  # [-] by which stamps of fixes are early before it is said
NOTABLE_SHARE = 0.01  # [-] of logs in which a run is right: less adds no tenth of its offset to the sigma
CONTRADICTED = 10.0  # [-] by judgement: a random walk of dead reckoning so much larger than stated is a fault


class ErrorEstimate(NamedTuple):
    """One number of a sensor error, in the unit of its name."""

    name: str
    value: float
    sd: float


class SensorErrorEvidence(NamedTuple):
    """What a log says of one sensor error."""

    key: str  # of usbl_likelihood.KEYS
    log_odds: float  # of the best explanation with the error against the best without
    exists: bool  # it is part of the best explanation
    estimates: tuple[ErrorEstimate, ...]  # empty if it does not exist
    effect_m: float = 0.0  # on the fixes of the log, RMS about its mean, which the start takes up


class Explanation(NamedTuple):
    """A set of sensor errors that explains a log."""

    keys: tuple[str, ...]  # of usbl_likelihood.KEYS; empty: no sensor has an error
    log_odds: float  # against the best set of errors, so at most 0; -inf if an error is far larger than is usual
    estimates: tuple[ErrorEstimate, ...]


class OpenPair(NamedTuple):
    """An error of a USBL head and one of the vehicle's sensors, of which the log shows little but the sum."""

    head: str  # keys of usbl_likelihood.KEYS
    vehicle: str
    away_m: float  # distance of the farthest fixes from the head
    sd_m: float  # 1-sigma that the pair leaves of the track there

    @property
    def text(self) -> str:
        """Say what is open, what it costs, and what would decide."""
        heading = self.head == "usbl-heading"
        errors = "headings of the USBL head and the compass" if heading else "ranges of the USBL and speeds of the DVL"
        key = "usbl_heading_sd_deg" if heading else "usbl_range_sd"
        return (
            f"of {errors} the log shows little but the difference, which leaves {self.sd_m:.2g} m open at "
            f"{self.away_m:.0f} m from the head (part of the track's sigma); GPS fixes (--aid), a head that moves, or "
            f"a survey of a transponder (usbldr calibrate-usbl) decide, or {key} under [calibrate] if the head is known"
        )


class NoiseChange(NamedTuple):
    """A number of the noise that was estimated from the log, see noise_fit.py."""

    name: str  # with its unit
    before: float
    after: float


class FalseRun(NamedTuple):
    """False fixes in a row."""

    start_s: float  # of the first and the last of them
    end_s: float
    fixes: int
    last: bool = False  # no fix follows them
    rival_share: float = 0.0  # of the logs in which so many are right and dead reckoning is wrong


@dataclass(frozen=True, slots=True)
class Identification:
    """The parameters of a run, and the evidence for them; ``evidence`` is empty if nothing was identified."""

    parameters: Parameters
    evidence: tuple[SensorErrorEvidence, ...] = ()
    noise_changes: tuple[NoiseChange, ...] = ()
    explanations: tuple[Explanation, ...] = ()  # the best, then rivals that the log cannot exclude

    open_pairs: tuple[OpenPair, ...] = ()
    false_runs: tuple[FalseRun, ...] = ()  # whose fixes are the parameters' false_fixes
    log_evidence: float = 0.0  # of the fixes, but for a constant, less what changes of sensors cost

    @property
    def estimates(self) -> Mapping[str, ErrorEstimate]:
        """Return the numbers of every sensor error that exists, by name."""
        return {estimate.name: estimate for one in self.evidence for estimate in one.estimates}

    @property
    def contested(self) -> frozenset[str]:
        """Return the keys of the errors that not every explanation contains."""
        sets = [set(one.keys) for one in self.explanations]
        return frozenset(key for one in sets for key in one if not all(key in other for other in sets))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return which fixes were left out, rivals, and what to check if the fixes contradict dead reckoning."""
        return (
            *([f"USBL-SMOOTHED: {text}"] if (text := self.smoothing_text) else []),
            *([f"FALSE-FIXES: {text}"] if (text := self.false_runs_text) else []),
            *(
                f"SENSOR-CHANGE: {text}; replay takes it into account, as the whole log shows it"
                for text in self.change_texts.values()
            ),
            *([f"RIVAL-EXPLANATIONS: {text}"] if (text := self.rival_shift_text) else []),
            *(f"RIVAL-EXPLANATIONS: {pair.text}" for pair in self.open_pairs),
            *([f"RIVAL-EXPLANATIONS: {text}"] if (text := self.misplaced_text) else []),
            *([f"USBL-LATENCY: {text}"] if (text := self._early_fixes_text) else []),
            *([f"LEVER-OR-LATENCY: {text}"] if (text := self.lever_or_latency_text) else []),
            *(
                f"the fixes contradict dead reckoning; process noise of dead reckoning was raised to {one.after:.2g} "
                "m/√s, so that the track follows the fixes: check the DVL's bottom lock, its axes and mounting, "
                "and the compass, or whether the fixes themselves drift"
                for one in self.noise_changes
                if one.name == DR_WALK_NAME and one.after > CONTRADICTED * one.before
            ),
        )

    @property
    def smoothing_text(self) -> str:
        """Return how software smoothed the fixes; "" if it did not."""
        smoothing = self.parameters.smoothing
        if smoothing == NOT_SMOOTHED:
            return ""
        how = "a filter that also estimates a velocity" if smoothing.velocity else "a weighted mean"
        how += f", in which a new fix has a weight of {smoothing.position:.0%}"
        if smoothing.last:
            how = f"the mean of the last {smoothing.last}"
        return (
            f"software smoothed the USBL fixes by {how}: they lag behind the vehicle; replay computes the fixes before "
            "they were smoothed; switch the filter of the USBL software off, or record unfiltered fixes"
        )

    @property
    def rival_shift_text(self) -> str:
        """Return how fixes may have shifted instead of the changes that are taken; "" if that is not likely."""
        shift = self.parameters.rival_shift
        if not shift:
            return ""
        return (
            f"{_shift_text((SensorChange(0.0, 0.0, 0.0), *shift)[-2], shift[-1])}: by the log this is nearly as likely "
            "as what the track assumes; its sigma covers both"
        )

    @property
    def misplaced_text(self) -> str:
        """Return what it costs if not the DVL is misplaced but the transponder; "" if neither is."""
        arm_m = [one.value for name, one in self.estimates.items() if name.startswith("dvl_lever")]
        if not arm_m:
            return ""
        length_m = math.hypot(*arm_m)
        return (
            f"DVL or transponder is {length_m:.2f} m from where it is stated (lever_arm_m), and the log does not show "
            "which of them: the track takes the transponder's place as right; if the DVL's is right instead, the track "
            f"is {length_m:.2f} m off (part of its sigma); measure both on the vehicle"
        )

    @property
    def _early_fixes_text(self) -> str:
        """Return what may be late instead if stamps of the fixes are early; "" if they are not."""
        latency = self.estimates.get("usbl_latency_s")
        if latency is None or -latency.value < EARLY_SIGMAS * latency.sd:
            return ""
        early = f"{-latency.value:.2f}"
        return (
            f"stamps of the fixes are {early} ± {latency.sd:.2f} s early by DVL and compass; if those two are late "
            f"instead, so is the track: state latency_s = -{early} under [usbl], or {early} under both [dvl] and "
            "[compass]"
        )

    @property
    def undecided(self) -> Mapping[str, ErrorEstimate]:
        """Return the lever arm and the latency, each as all of what the log shows; empty if these two are decided."""
        if self.contested != LEVER_OR_LATENCY:
            return {}
        value = {one.name: one for found in self.explanations for one in found.estimates}
        return {name: one for name, one in value.items() if name == "usbl_latency_s" or name.startswith("dvl_lever")}

    @property
    def decided(self) -> tuple[SensorErrorEvidence, ...]:
        """Return the evidence for the other errors."""
        return tuple(one for one in self.evidence if not (self.undecided and one.key in LEVER_OR_LATENCY))

    @property
    def lever_or_latency_text(self) -> str:
        """Return what the log shows of the lever arm or the latency; "" if these two are not undecided."""
        if not self.undecided:
            return ""
        late, ahead = (self.undecided[name] for name in ("usbl_latency_s", "dvl_lever_forward_m"))
        errors = self.parameters.errors
        usual = abs(late.value) <= UNUSUAL * errors.latency_s or abs(ahead.value) <= UNUSUAL * errors.dvl_lever_m
        clock, place = ("late", "ahead") if late.value > 0 else ("early", "astern")
        return (
            f"either stamps of the fixes are {abs(late.value):.2f} ± {late.sd:.2f} s {clock} (latency_s under [usbl]), "
            f"or the DVL is {abs(ahead.value):.2f} ± {ahead.sd:.2f} m further {place} of the transponder than stated "
            f"(lever_arm_m), or a part of each{'' if usual else ', which are more than is usual'}: at one speed the "
            "log shows only their sum; the track takes all of it as latency, and its sigma covers the lever arm; "
            "another speed or a measured lever arm decides"
        )

    @property
    def change_texts(self) -> Mapping[float, str]:
        """Return when sensors changed -> what the change is, and what to check."""
        before, texts = SensorChange(0.0, 0.0, 0.0), dict[float, str]()
        if gradual := [one for one in self.parameters.changes if one.gradual]:
            texts[gradual[0].start_s] = _gradual_text(gradual)
        for one in self.parameters.changes:
            if before.lost:
                texts[before.start_s] = (
                    f"from {before.start_s:.0f} to {one.start_s:.0f} s DVL or compass do not read the vehicle's "
                    "motion, as the fixes before and after show: neither is used in this time (check bottom lock and "
                    "magnetic disturbances; or the USBL's head or beacon was moved)"
                )
            before, last = one, before
            if one.lost or last.lost or math.isinf(one.start_s):
                continue
            if of_fixes := _change_of_fixes_text(last, one):
                texts[one.start_s] = of_fixes
                continue
            if one.gradual:
                continue
            if one.current_mps != last.current_mps:
                if any(one.current_mps):
                    texts[one.start_s] = self._water_text(one)
                continue
            turned_deg = math.degrees(math.remainder(last.heading_bias_rad - one.heading_bias_rad, 2 * math.pi))
            scale = (1 + one.dvl_scale) / (1 + last.dvl_scale) - 1
            check = "check compass and DVL at this time: mounting, sound speed, bottom lock"
            if max(1 + scale, 1 / (1 + scale)) > MOST_OF_SCALE:
                check = "so much is no scale error: the DVL has no bottom lock or repeats itself, or the fixes do"
            texts[one.start_s] = (
                f"from {one.start_s:.0f} s on headings read {turned_deg:+z.1f}° and speeds {scale:+z.1%} compared with "
                f"before ({check})"
            )
        return texts

    def _water_text(self, change: SensorChange) -> str:
        """Return how the DVL's velocities differ from those over ground, and how long."""
        ends_s = [one.start_s for one in self.parameters.changes if one.current_mps != change.current_mps]
        end_s = min((time_s for time_s in ends_s if time_s > change.start_s), default=math.inf)
        until = f"to {end_s:.0f} s" if math.isfinite(end_s) else "s on"
        east_mps, north_mps = change.current_mps
        towards_deg = math.degrees(math.atan2(-east_mps, -north_mps)) % 360
        return (
            f"from {change.start_s:.0f} {until} the DVL reads {math.hypot(east_mps, north_mps):.2f} m/s more towards "
            f"{towards_deg:.0f}° than over ground (check bottom lock and altitude: it may measure through moving water)"
        )

    @property
    def false_runs_text(self) -> str:
        """Return which fixes are false, and why; "" if none is."""
        if not self.false_runs:
            return ""
        longest = max(self.false_runs, key=lambda run: run.fixes)
        count, where = sum(run.fixes for run in self.false_runs), f"from {longest.start_s:.0f} to {longest.end_s:.0f} s"
        if len(self.false_runs) > 1 and longest.fixes <= OUTLIERS:
            return (
                f"{count} USBL fixes, no more than {OUTLIERS} in a row, lie beside the track that dead reckoning and "
                "the other fixes give: they are left out as outliers; check for echoes, and whether noise under "
                "[usbl] allows for outliers"
            )
        if len(self.false_runs) > 1:
            where = f"in {len(self.false_runs)} runs, the longest {where}"
        lie, are = f"{count} USBL fixes ({where}) lie together", "they are"
        if count == 1:
            lie, are = f"a USBL fix at {longest.start_s:.0f} s lies", "it is"
        decided = "as the whole log shows"
        for run in self.false_runs:
            if run.last:
                decided += f"; no fix follows those from {run.start_s:.0f} s on: perhaps dead reckoning is wrong there"
            elif run.rival_share > NOTABLE_SHARE:
                decided += (
                    f"; those from {run.start_s:.0f} to {run.end_s:.0f} s are so many that perhaps dead reckoning is "
                    "wrong before or after them instead, which is part of the track's sigma there"
                )
        return (
            f"{lie} beside the track that dead reckoning and the other fixes give: {are} left out as false, {decided}"
            "; check for echoes, a second beacon, a head that moved, errors of the ship's GPS or gyro, or positions "
            "written before the first reply"
        )


def _gradual_text(changes: Sequence[SensorChange]) -> str:
    """Return how headings drift or differ twice per turn, what the DVL adds at any speed, and how clocks part."""
    turned = {one.start_s: -math.degrees(one.heading_bias_rad) for one in changes}
    shown_s = dict.fromkeys((max(turned, key=lambda time_s: abs(turned[time_s])), changes[-1].start_s))
    read = " and ".join(f"{turned[time_s]:+.1f}° at {time_s:.0f} s" for time_s in shown_s)
    texts = [f"headings drift: compared with the first ones they read {read}"] if any(turned.values()) else []
    if any(changes[0].twice_per_turn_rad):
        sine_deg, cosine_deg = np.degrees(changes[0].twice_per_turn_rad).tolist()  # psi is 90° - H
        texts.append(
            f"the compass has a deviation of ({-sine_deg:.1f}) sin 2H + ({cosine_deg:.1f}) cos 2H deg at heading H"
        )
    check = ["the compass: iron or currents near it, warm-up of a gyro"] if texts else []
    if late_s := changes[-1].fix_late_s:
        later = "later" if late_s > 0 else "earlier"
        texts.append(f"stamps of the USBL fixes become {abs(late_s):.2f} s {later} than at the start of the log")
        check.append("that the clocks of USBL and vehicle are synchronised, or whether positions wait in a queue")
    if any(bias_mps := changes[0].dvl_bias_mps):
        starboard, forward = bias_mps
        texts.append(f"the DVL reads {forward:+.3f} m/s forward and {starboard:+.3f} m/s to starboard at any speed")
        check.append("the DVL: fouled beams, tilt, bottom lock")
    return f"{'; '.join(texts)} (check {'; '.join(check)})"


def _change_of_fixes_text(before: SensorChange, after: SensorChange) -> str:
    """Return how the fixes differ from those before; "" if they do not."""
    since, late_s = f"from {after.start_s:.0f} s on", (after.fix_late_s - before.fix_late_s) * (not after.gradual)
    if after.fix_sd_scale != before.fix_sd_scale:
        factor = after.fix_sd_scale / before.fix_sd_scale
        return f"{since} the USBL fixes scatter {factor:.2g} times as much as before (check range, noise and the head)"
    if late_s:
        later = f"stamps of the USBL fixes are {abs(late_s):.1f} s {'later' if late_s > 0 else 'earlier'} than before"
        return f"{since} {later} (check clocks and exports)"
    if after.fix_shift_m == before.fix_shift_m:
        return ""
    return (
        f"{_shift_text(before, after)} (check whether the head, its GPS, the beacon or the origin of the map changed, "
        "or whether DVL or compass failed shortly before; the log does not show which fixes are right: the earlier "
        "ones are taken unless they are clearly fewer, and the track's sigma covers the others)"
    )


def _shift_text(before: SensorChange, after: SensorChange) -> str:
    """Return when and how far the fixes shifted."""
    east_m, north_m = np.subtract(after.fix_shift_m, before.fix_shift_m).tolist()
    where = f"{abs(east_m):.1f} m {'east' if east_m > 0 else 'west'} and {abs(north_m):.1f} m"
    return (
        f"from {after.start_s:.0f} s on the USBL fixes lie {where} {'north' if north_m > 0 else 'south'} of where they "
        "lay before"
    )
