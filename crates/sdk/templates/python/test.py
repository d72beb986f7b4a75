"""`python3 -m unittest` in this folder; needs nothing but Python."""

import unittest

from @module@ import @Class@
from plumbline.trial import Checks


class @Class@Test(Checks, unittest.TestCase):
    """What every stage must be able to do; add what yours is for."""

    stage = @Class@


if __name__ == "__main__":
    unittest.main()
