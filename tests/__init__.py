"""Packages, with those of its folders whose tests share robots, so that fixtures may have the scope package."""
