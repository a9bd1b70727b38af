"""The feature suite: subclass it, give what only the author knows, and it proves the rest."""

from __future__ import annotations

from rcp_gateway.testing.feature._guard import GuardTests
from rcp_gateway.testing.feature._life import LifeTests
from rcp_gateway.testing.feature._rig import FeatureGateway, FeatureRig

__all__ = ["FeatureGateway", "FeatureSuite"]


class FeatureSuite(LifeTests, GuardTests):
    """All tests of a feature.

    Give `kind` (and `options`); for a guard, the code of its `refusal`, `engage` and `release`::

        class TestMaintenance(FeatureSuite):
            kind = rcp_maintenance.MAINTENANCE refusal = "mode_forbids"

            async def engage(self, gateway: FeatureGateway) -> None:
                await gateway.admin.request("execute", "/system/maintenance", body={"do": "begin"})

    A test of the suite that cannot hold is overridden under `pytest.mark.xfail(reason=…)`.
    """

    def test_no_test_of_the_suite_is_changed_without_a_reason(self) -> None:
        """See that nothing was overridden or taken out but under xfail with a reason."""
        assert self.altered(FeatureSuite) == []

    def test_a_guard_comes_with_what_proves_it(self) -> None:
        """See that the author gave all three of `refusal`, `engage` and `release`, or none."""
        own = type(self)
        given = [own.refusal is not None]
        given += [getattr(own, n) is not getattr(FeatureRig, n) for n in ("engage", "release")]
        assert len(set(given)) == 1, "give `refusal`, `engage` and `release`, or none of them"
