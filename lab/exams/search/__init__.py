"""The rooms of the exam that lab/exams/retrieval.py sits: keep them unread by who works on the retrieval."""
