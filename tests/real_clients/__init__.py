"""One robot for all tests: it is switched off after the last test of this folder (fixtures of scope "package")."""
