"""The tables of a store: the same in SQLite and PostgreSQL, every unit in its column's name."""

from __future__ import annotations

from sqlalchemy import JSON, Column, DateTime, Double, ForeignKey, Index, Integer, MetaData, Table, Text

from cadcam.record.record import LIMITS, PLACE, ROTATION, UNITS

VERSION = 2  # 1 had no findings, and no index by serial

tables: MetaData = MetaData()

store: Table = Table("cadcam_store", tables, Column("version", Integer, nullable=False), Column("software", Text))

# world_from_part is the rotation r11 ... r33 and the translation x y z; null where the part was not found
measurement: Table = Table(
    "measurement",
    tables,
    Column("id", Text, primary_key=True),
    Column("time_utc", DateTime, nullable=False),
    Column("part", Text, nullable=False),
    Column("serial", Text, nullable=False),
    Column("station", Text, nullable=False),
    Column("verdict", Text, nullable=False),
    Column("reason", Text, nullable=False),
    Column("quality", Double),
    *(Column(name, Double) for name in (*PLACE, *ROTATION)),
    Column("uncertainty_mm_rad", JSON),  # the pose's covariances, its freedom and degrees of freedom
    Column("software", Text, nullable=False),
    Index("measurement_by_part", "part", "time_utc"),
    Index("measurement_by_time", "time_utc"),
    Index("measurement_by_serial", "serial"),
)


def _belongs() -> tuple[Column[str], Column[int]]:
    """Return the columns shared by tables of a measurement's details: the measurement, and the position in its list."""
    return (
        Column("measurement_id", Text, ForeignKey("measurement.id"), primary_key=True),
        Column("place", Integer, primary_key=True),
    )


# lengths are in the columns _mm, angles in those _deg, the others are null
deviation: Table = Table(
    "deviation",
    tables,
    *_belongs(),
    Column("feature", Text, nullable=False),
    Column("kind", Text, nullable=False),
    Column("verdict", Text, nullable=False),
    Column("k", Double, nullable=False),
    *(Column(f"{name}_{unit}", Double) for unit in UNITS for name in LIMITS),
    Index("deviation_by_feature", "feature"),
)

# what was judged without a number
finding: Table = Table(
    "finding",
    tables,
    *_belongs(),
    Column("feature", Text, nullable=False),
    Column("kind", Text, nullable=False),
    Column("verdict", Text, nullable=False),
    Column("reason", Text, nullable=False),
    Index("finding_by_feature", "feature"),
)

JUDGED: tuple[Table, ...] = (deviation, finding)

source: Table = Table(
    "source",
    tables,
    *_belongs(),
    Column("role", Text, nullable=False),
    Column("path", Text, nullable=False),
    Column("sha256", Text, nullable=False),
    Index("source_by_sha256", "sha256"),
)
