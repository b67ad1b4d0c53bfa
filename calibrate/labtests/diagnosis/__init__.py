"""Curves as numbers: `base` says what a feature is, one file a type of test declares and reads its
own, `contact` tells where a record begins, `curves` joins the tests."""
