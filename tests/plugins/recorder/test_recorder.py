"""Recordings have what happened, open with the reader of others, and are seen by who may."""

from __future__ import annotations

import pytest

import rcp_recorder
from rcp_kernel.testing import FeatureSuite

(KIND,) = rcp_recorder.rcp_features()


class TestRecorder(FeatureSuite):
    kind = KIND

    @pytest.fixture(autouse=True)
    def _folder(self, tmp_path):
        self.options = {"folder": str(tmp_path), "paths": ["/tenant/**"], "black_box": {}}
