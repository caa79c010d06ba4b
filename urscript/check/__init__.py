"""``urscript check``: find what is wrong with programs before a controller does.

    signatures      the built-ins, without the emulator
    rules           what is checked: a code, a name and a function each
    subject         a program as the rules see it
    project         the project file: versions, names known from outside, selected rules
    sources         the programs in script files, templates, program trees, Python and C++
    checking        the findings of a source, for one version or several
    formats         how they are reported
    command         the options, and the exit status

The language itself knows nothing of this package. What a controller reports as well comes from the compiler: errors
with their hints (`urscript.hints`), and calls that will fail (`urscript.literals`).
"""
