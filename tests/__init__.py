"""A package, like the folders whose tests share robots, so that fixtures can have the scope "package"."""
