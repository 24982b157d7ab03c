"""The rooms of the exam that lab/exams/evaluation.py sits: keep them unread by who works on the evaluation."""
