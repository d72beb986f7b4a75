"""Tests of the stage. Run `python3 -m unittest` in this folder; they need only Python."""

import unittest

from @module@ import @Class@
from plumbline.stage_tests import StageTests


class @Class@Test(StageTests, unittest.TestCase):
    """Tests that every stage must pass. Add the tests of this stage."""

    stage = @Class@


if __name__ == "__main__":
    unittest.main()
