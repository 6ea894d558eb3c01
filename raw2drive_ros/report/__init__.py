"""Pictures, videos and HTML reports from bags and results."""
