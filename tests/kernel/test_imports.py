"""No files of a package import each other in a circle, type-checking imports counted."""

from __future__ import annotations

from graphlib import CycleError, TopologicalSorter

import grimp
import pytest


@pytest.mark.parametrize(
    "package", ["rcp_kernel", "rcp_streams", "rcp_requests", "rcp_gateway", "rcp_ros2"]
)
def test_files_import_one_way(package: str) -> None:
    graph = grimp.build_graph(package, cache_dir=None)
    files = {one: graph.find_modules_directly_imported_by(one) for one in graph.modules}
    try:
        TopologicalSorter(files).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))
