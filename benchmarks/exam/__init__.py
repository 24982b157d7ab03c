"""The rooms of the exam that benchmarks/exam_evaluation.py sits: keep them unread by who works on the evaluation."""
