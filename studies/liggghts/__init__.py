"""This product beside LIGGGHTS: cases whose reality it computes, both codes at equal parameters.

    cases        `generate` makes them (cases, effects, soil, physics, specimen, referee,
                 instrument, labfiles); `studies.sealed`, `references`, `visibility` and `further`
                 judge them
    both codes   `codes` (one_contact, both_tests) and `export_contact` (two_spheres)

README.md says how cases are made, and what limits them.
"""
