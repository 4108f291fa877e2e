def write_study_report(summary, folder):
    pass
