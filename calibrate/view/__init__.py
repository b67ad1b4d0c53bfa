"""Looking into the bed: its state at many moments, the forces in its contacts, files for ParaView.

frames -> contacts -> vtk
"""
