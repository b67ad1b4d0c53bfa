"""Curves as numbers: `base` says what a feature is, one file a type of test declares and reads its
own, `branches` and `contact` read noisy curves, `curves` joins the tests."""
