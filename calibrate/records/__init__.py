"""What the JSON files of results hold, checked: one file for each kind of result.

    calibrate fit    -> result.json -> records.fit.FitRecord     -> figures, report
    calibrate audit  -> audit.json  -> records.audit.AuditRecord -> figures, report
    calibrate doe    -> result.json -> records.study.StudyRecord -> report

Figures and reports are made from records alone, so they can be made again from a folder that
came from elsewhere.  Nothing in such a file is trusted: names must be names that we know,
numbers numbers, and arrays must fit together.
"""
