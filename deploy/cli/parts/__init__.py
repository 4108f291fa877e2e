"""Parts that commands share: options, progress, gates, and how a study is carried out."""
