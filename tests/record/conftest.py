"""A store of each kind, empty, for every test that asks for one."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest
import sqlalchemy as sql

from .postgres import postgres_server


@pytest.fixture(scope="session")
def server() -> Iterator[str]:
    """Yield the URL of a PostgreSQL server."""
    if find_spec("pg8000") is None:
        pytest.skip("pg8000 is not installed")
    with postgres_server() as url:
        yield url


@pytest.fixture(params=["sqlite", "postgresql"])
def where(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[str]:
    """Yield the address of a store that does not exist yet."""
    if request.param == "sqlite":
        yield str(tmp_path / "parts.sqlite")
        return
    url = request.getfixturevalue("server")
    engine = sql.create_engine(url.replace("postgresql:", "postgresql+pg8000:"), isolation_level="AUTOCOMMIT")
    with engine.connect() as connection:
        connection.exec_driver_sql("CREATE DATABASE parts")
    yield url.removesuffix("/postgres") + "/parts"
    with engine.connect() as connection:
        connection.exec_driver_sql("DROP DATABASE parts WITH (FORCE)")
    engine.dispose()
