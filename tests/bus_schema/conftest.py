"""What tests of robot descriptions share."""

import pytest

from bus_schema.robot_description import load_robot


@pytest.fixture
def load(tmp_path):
    """Loads a text as the file ``arm.urdf`` of the test's folder."""

    def load_text(text, *arguments, **options):
        path = tmp_path / "arm.urdf"
        path.write_text(text)
        return load_robot(path, *arguments, **options)

    return load_text
