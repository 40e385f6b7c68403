"""The thread-scaling study: one scene, timed over thread counts, widths and OpenMP schedules.

`plan` says what to measure, `measure` runs it, `summary` and `amdahl` work the runs out, and
`charts`, `report` and `output` write what came out. `original` holds the published figures of the
study this package grew out of.
"""
