{{- define "revisit.name" -}}
{{- if contains .Chart.Name .Release.Name }}{{ .Release.Name }}{{ else }}{{ .Release.Name }}-{{ .Chart.Name }}{{ end -}}
{{- end }}

{{- define "revisit.selector" -}}
app.kubernetes.io/name: {{ .Chart.Name }}
app.kubernetes.io/instance: {{ .Release.Name }}
{{- end }}

{{- define "revisit.labels" -}}
{{ include "revisit.selector" . }}
app.kubernetes.io/version: {{ .Values.image.tag | default .Chart.AppVersion | quote }}
app.kubernetes.io/managed-by: {{ .Release.Service }}
helm.sh/chart: {{ .Chart.Name }}-{{ .Chart.Version }}
{{- end }}

{{- define "revisit.container" -}}
image: "{{ .Values.image.repository }}:{{ .tag | default .Values.image.tag | default .Chart.AppVersion }}"
imagePullPolicy: {{ .Values.image.pullPolicy }}
securityContext:
  allowPrivilegeEscalation: false
  readOnlyRootFilesystem: true
  capabilities: {drop: [ALL]}
volumeMounts:
  - {name: data, mountPath: /data}
  - {name: tmp, mountPath: /tmp}
{{- end }}

{{- define "revisit.pod" -}}
serviceAccountName: {{ include "revisit.name" . }}
automountServiceAccountToken: false
# Otherwise a service called revisit puts REVISIT_PORT=tcp://... into every pod beside it.
enableServiceLinks: false
{{- with .Values.image.pullSecrets }}
imagePullSecrets:
{{- range . }}
  - name: {{ . }}
{{- end }}
{{- end }}
securityContext:
  runAsNonRoot: true
  runAsUser: 10001
  runAsGroup: 10001
  fsGroup: 10001
  fsGroupChangePolicy: OnRootMismatch
  seccompProfile: {type: RuntimeDefault}
{{- end }}

{{- define "revisit.placement" -}}
{{- with .nodeSelector }}
nodeSelector: {{- toYaml . | nindent 2 }}
{{- end }}
{{- with .tolerations }}
tolerations: {{- toYaml . | nindent 2 }}
{{- end }}
{{- with .affinity }}
affinity: {{- toYaml . | nindent 2 }}
{{- end }}
{{- end }}

{{/* Variables of a process. The argument: root, settings of its own, and `encodes` for a shared encoder, which has no data. */}}
{{- define "revisit.environment" -}}
{{- $values := .root.Values -}}
{{- $given := mustMergeOverwrite (dict "REVISIT_LOG" "json") (deepCopy $values.settings) (deepCopy .settings) -}}
{{- range $name := list "REVISIT_DATA" "REVISIT_HOST" "REVISIT_PORT" "REVISIT_DATABASE" "REVISIT_IMAGES" "REVISIT_INLINE_WORKER" "REVISIT_ENCODER_URL" "REVISIT_ENCODER_KEY" -}}
{{- if hasKey $given $name }}{{ fail (printf "%s is set by the chart; see values.yaml" $name) }}{{ end -}}
{{- end -}}
{{- range $name, $value := $given }}
- {name: {{ $name }}, value: {{ $value | quote }}}
{{- end }}
{{- with $values.encoders.secret }}
- name: REVISIT_ENCODER_KEY
  valueFrom: {secretKeyRef: {name: {{ . }}, key: {{ $values.encoders.key }}}}
{{- end }}
{{- if not .encodes }}
{{- if or $values.encoders.url (gt (int $values.encoders.replicas) 0) }}
- {name: REVISIT_ENCODER_URL, value: {{ $values.encoders.url | default (printf "http://%s-encoder:8000" (include "revisit.name" .root)) | quote }}}
{{- end }}
{{- if $values.database.secret }}
- {name: REVISIT_INLINE_WORKER, value: "false"}
- name: REVISIT_DATABASE
  valueFrom: {secretKeyRef: {name: {{ $values.database.secret }}, key: {{ $values.database.key }}}}
- {name: REVISIT_IMAGES, value: {{ $values.images.location | quote }}}
- {name: AWS_REGION, value: {{ $values.images.region | quote }}}
{{- with $values.images.endpoint }}
- {name: AWS_ENDPOINT_URL_S3, value: {{ . | quote }}}
{{- end }}
{{- with $values.images.secret }}
- name: AWS_ACCESS_KEY_ID
  valueFrom: {secretKeyRef: {name: {{ . }}, key: AWS_ACCESS_KEY_ID}}
- name: AWS_SECRET_ACCESS_KEY
  valueFrom: {secretKeyRef: {name: {{ . }}, key: AWS_SECRET_ACCESS_KEY}}
{{- end }}
{{- end }}
{{- end }}
{{- end }}
