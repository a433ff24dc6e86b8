"""What is said to a driver: codes, which stay, and sentences."""

from __future__ import annotations

from nav_core.records import Reason

REASONS = {
    "no_fix": "No satellite fix yet: give the antenna a view of the sky.",
    "few_fixes": "Only just begun: drive a few minutes.",
    "no_accelerometer": "No accelerometer data for the time of the satellite fixes.",
    "not_driven": "The vehicle has not been driven yet: drive a few minutes.",
    "few_events": "Drive a few minutes with some accelerating and braking.",
    "no_turns": "Make two turns.",
    "keep_driving": "Keep driving: the estimate is still getting better.",
    "mismatch": "The accelerations do not match the satellite speed: is the vehicle being carried or towed?",
    "rough": "The satellite data are poor or the ride is very rough; this takes longer.",
    "contradiction": "Parts of the drive disagree about how the box sits: check that it is fixed firmly.",
    "startled": "The box may just have been moved: keep driving.",
    "loose": "The box moves in its holder: fix it firmly.",
    "slipping": "The box seems to turn slowly in its holder: check that it is fixed firmly.",
    "wrong_unit": "The accelerometer sends {} instead of m/s²: correct its unit.",
    "no_gravity": "The accelerometer sends acceleration without gravity: switch it to specific force.",
    "dead_accelerometer": "The accelerometer sends nothing but zeros.",
    "dead_axis": "One axis of the accelerometer always sends the same number: the box needs repair.",
    "stuck_axis": "One axis of the accelerometer stood still for {} s of driving; they were left out.",
    "mirrored": "The accelerometer's sign is inverted, or one of its axes is: correct the sign in the box.",
    "handedness_open": "Make two turns: the drive does not yet tell whether the accelerometer's signs are right.",
    "no_course": "The satellite receiver gives no course: whether the accelerometer's signs are right cannot be told.",
    "handedness_trusted": "Without a bend, that the accelerometer's signs are right is taken on trust.",
    "reversing": "{} s of reversing were left out.",
    "gps_frozen": "The satellite receiver repeated old fixes for {} s; they were left out.",
    "gps_late": "The satellite receiver is {} s late; this is accounted for.",
    "gps_speed_unit": "The satellite receiver sends its speed in {} instead of m/s: correct its unit.",
    "gps_course_unit": "The satellite receiver sends its course {} instead of in rad clockwise from north: correct it.",
    "gyro_dead": "One axis of the gyro always sends the same number: the gyro is left out.",
    "gyro_unit": "The gyro sends {} instead of rad/s: correct its unit; until then it is left out.",
    "gyro_wrong": "The gyro does not turn as the course does (its sign, axes or scale): it is left out.",
    "gyro_noisy": "What the gyro sends has nothing to do with the vehicle's turning: it is left out.",
    "slow_gps": "The satellite receiver gives {} fixes a second: enough, but it takes longer.",
    "slow_accelerometer": "The accelerometer gives only {} samples a second: vibration blurs it, and it takes longer.",
    "clock_jump": "The clock of the box jumped by {} s.",
    "clock_torn": "The clock of the box jumped back; {} s around it were left out.",
    "clock_back": "The clock of the box jumped back by {} s: the estimate began anew.",
    "utc_jump": "The receiver's UTC jumped by {} s against the clock of the box.",
    "aboard": "For {} min the vehicle was carried, by a ferry or a train; this was left out.",
    "carried": "For a while the vehicle sat differently and came back: was it carried or towed?",
}


def reason(code: str, value: str = "") -> Reason:
    """The reason of a code, with its sentence and the value it speaks of.

    Parameters
    ----------
    code : str
        Key of `REASONS`.
    value : str
        With its unit where the sentence has none.

    Returns
    -------
    Reason
        Code and English sentence.

    Raises
    ------
    KeyError
        For a code that has no sentence.
    """
    return Reason(code, REASONS[code].format(value))
